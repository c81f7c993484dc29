//! The interface of a model: its table with a name, its GUID, and its copy in the FMU binary.
//!
//! The copy is written at compile time and found by its first bytes, so that a binary for any platform can
//! be read without running it. Its format is that of postcard, so that serde reads it. The GUID is the hash of
//! the parts that make up the identity of the interface.

use crate::hash::{Hash, checksum};
use crate::table::{Bounds, Dynamics, Field, Item, Scalar, Start};
use crate::{Type, Value, value};

/// All that an FMU binary knows of a model's interface.
#[derive(Debug, Clone, Copy)]
pub struct Interface {
    /// Name of the model, of the FMU and of its binary: a C identifier.
    pub name: &'static str,
    /// Description of the model in one sentence.
    pub description: &'static str,
    /// Whether it has a sample time; its outputs then change at sample instants only.
    pub is_sampled: bool,
    /// Whether it is described by differential or algebraic equations, which a host can solve.
    pub is_continuous: bool,
    /// Stop time and communication step size (s) of the default experiment.
    pub default_experiment: (f64, f64),
    /// Relative tolerance of its integrator, also part of the default experiment; 0 if it has none.
    pub tolerance: f64,
    /// The scalar variables; their indices are their value references.
    pub scalars: &'static [Scalar],
    /// Start values that differ from the table.
    pub overrides: Overrides,
}

/// Start values of a variant by value reference, in the text that the exporter passes to the compiler: for
/// each, `REFERENCE:TYPE LENGTH:VALUE` without spaces, where the type is `r`, `i`, `b`, `s` or `x`: a real
/// number as 16 hexadecimal digits, its bits; a whole number or that of an item; 0 or 1; a text; bytes as
/// hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overrides(&'static str);

/// A start value of a variant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Override<'a> {
    /// The value reference of the variable.
    pub reference: usize,
    pub(crate) kind: u8,
    pub(crate) text: &'a str,
}

impl Overrides {
    /// No overrides.
    pub const NONE: Self = Self("");

    /// The name of a variant of the model `base`, and its start values, from the text
    /// `BASE=NAME;OVERRIDES`; `None` if it is a variant of another model.
    pub const fn of(base: &str, text: &'static str) -> Option<(&'static str, Self)> {
        let (of, rest) = split(text, b'=');
        if Hash::new().bytes(of.as_bytes()).0 != Hash::new().bytes(base.as_bytes()).0 {
            return None;
        }
        let (name, overrides) = split(rest, b';');
        Some((name, Self(overrides)))
    }

    /// The first override, and those after it.
    pub const fn next(self) -> Option<(Override<'static>, Self)> {
        if self.0.is_empty() {
            return None;
        }
        let (reference, rest) = split(self.0, b':');
        let (kind, rest) = rest.split_at(1);
        let (length, rest) = split(rest, b':');
        let (text, rest) = rest.split_at(number(length, 10) as usize);
        let first = Override {
            reference: number(reference, 10) as usize,
            kind: kind.as_bytes()[0],
            text,
        };
        Some((first, Self(rest)))
    }
}

impl Override<'_> {
    /// The value of a variable; `None` if its type does not have it.
    pub fn value(self, of_type: Type) -> Option<Value> {
        match self.kind {
            b'r' => Value::real(of_type, f64::from_bits(number(self.text, 16) as u64)),
            b'i' => Value::whole(of_type, number(self.text, 10)),
            b'b' => Some(Value::Boolean(number(self.text, 10) == 1)),
            b'x' => value::bytes(self.text).map(Value::Binary),
            _ => Some(Value::String(self.text.to_owned())),
        }
    }
}

/// The text of `BASE=NAME;OVERRIDES` for [`Overrides::of`], from value references and values.
pub fn variant(base: &str, name: &str, overrides: &[(usize, Value)]) -> String {
    let overrides: String = overrides
        .iter()
        .map(|(reference, value)| {
            let (kind, text) = match (value, value.as_real()) {
                (_, Some(real)) => ('r', format!("{:016x}", real.to_bits())),
                (Value::Boolean(value), _) => ('b', u8::from(*value).to_string()),
                (Value::String(text), _) => ('s', text.clone()),
                (Value::Binary(_), _) => ('x', value.to_string()),
                _ => ('i', value.to_string()),
            };
            format!("{reference}:{kind}{}:{text}", text.len())
        })
        .collect();
    format!("{base}={name};{overrides}")
}

/// The parts of a text before and after a byte.
const fn split(text: &'static str, at: u8) -> (&'static str, &'static str) {
    let mut i = 0;
    while i < text.len() && text.as_bytes()[i] != at {
        i += 1;
    }
    let (before, rest) = text.split_at(i);
    match rest.is_empty() {
        true => (before, ""),
        false => (before, rest.split_at(1).1),
    }
}

const fn number(text: &str, radix: u32) -> i128 {
    match i128::from_str_radix(text, radix) {
        Ok(number) => number,
        Err(_) => panic!("the overrides of a variant are damaged"),
    }
}

/// Length of a GUID as text, including the braces.
pub const GUID_LENGTH: usize = 38;
/// The first bytes of a copy.
pub(crate) const MAGIC: [u8; 16] = *b"\x7fFMU-INTERFACE\x7f\n";
/// Version of the format of copies; increase it when the format changes.
pub(crate) const VERSION: u32 = 5;
/// Size of the checksum at the end of a copy.
pub(crate) const CHECKSUM: usize = size_of::<u128>();

/// The GUID of a model: the 128-bit FNV-1a hash of its name and its variables (names, order,
/// causality, variability, types, starts, bounds, units), formatted as a version 8 UUID. It is the
/// same in every build and changes with the interface.
pub const fn guid(interface: &Interface) -> [u8; GUID_LENGTH] {
    format(written::<0>(interface).identity.0)
}

/// Size of the copy of an interface in bytes.
pub const fn size(interface: &Interface) -> usize {
    written::<0>(interface).length
}

/// The copy of an interface; `N` is its [`size`].
pub const fn write<const N: usize>(interface: &Interface) -> [u8; N] {
    let writer = written::<N>(interface);
    assert!(writer.length == N, "N is the size of the copy");
    writer.bytes
}

const fn written<const N: usize>(interface: &Interface) -> Writer<N> {
    let mut writer = Writer {
        bytes: [0; N],
        length: 0,
        identity: Hash::new(),
    };
    writer.note(&MAGIC);
    writer.note(&VERSION.to_le_bytes());
    // The first pass, which computes the length, does not know it.
    writer.note(&(N as u32).to_le_bytes());
    writer.interface(interface);
    writer.note_bytes(&format(writer.identity.0));
    let (content, _) = writer.bytes.split_at(N.saturating_sub(CHECKSUM));
    let sum = checksum(content);
    writer.note(&sum.to_le_bytes());
    writer
}

/// Writes the first `N` bytes of a copy, counts the others, and hashes what makes up the identity.
struct Writer<const N: usize> {
    bytes: [u8; N],
    length: usize,
    identity: Hash,
}

impl<const N: usize> Writer<N> {
    /// Adds bytes to the copy.
    const fn note(&mut self, bytes: &[u8]) {
        let mut i = 0;
        while i < bytes.len() {
            if self.length < N {
                self.bytes[self.length] = bytes[i];
            }
            self.length += 1;
            i += 1;
        }
    }

    /// Adds a whole number to the copy, seven bits a byte.
    const fn note_number(&mut self, mut number: u128) {
        while number > 0x7f {
            self.note(&[number as u8 | 0x80]);
            number >>= 7;
        }
        self.note(&[number as u8]);
    }

    /// Adds a whole number that may be negative to the copy.
    const fn note_whole(&mut self, number: i128) {
        self.note_number((number << 1 ^ number >> 127) as u128);
    }

    const fn note_real(&mut self, number: f64) {
        self.note(&number.to_bits().to_le_bytes());
    }

    /// Adds bytes and their number to the copy.
    const fn note_bytes(&mut self, bytes: &[u8]) {
        self.note_number(bytes.len() as u128);
        self.note(bytes);
    }

    const fn note_texts(&mut self, texts: &[&str]) {
        self.note_number(texts.len() as u128);
        let mut i = 0;
        while i < texts.len() {
            self.note_bytes(texts[i].as_bytes());
            i += 1;
        }
    }

    /// Adds bytes to the identity.
    const fn identify(&mut self, bytes: &[u8]) {
        self.identity = self.identity.bytes(bytes);
    }

    const fn identify_number(&mut self, number: u64) {
        self.identify(&number.to_le_bytes());
    }

    /// Adds a text to the identity, and a byte that UTF-8 does not have: "a", "bc" differs from "ab", "c".
    const fn identify_text(&mut self, text: &str) {
        self.identify(text.as_bytes());
        self.identify(&[0xff]);
    }

    /// Adds a flag or the index of a keyword to both.
    const fn byte(&mut self, byte: u8) {
        self.note(&[byte]);
        self.identify(&[byte]);
    }

    /// Adds a text to both.
    const fn text(&mut self, text: &str) {
        self.note_bytes(text.as_bytes());
        self.identify_text(text);
    }

    const fn interface(&mut self, interface: &Interface) {
        let Interface { scalars, .. } = *interface;
        self.text(interface.name);
        self.note_bytes(interface.description.as_bytes());
        self.byte(interface.is_sampled as u8);
        self.byte(interface.is_continuous as u8);
        self.note_real(interface.default_experiment.0);
        self.note_real(interface.default_experiment.1);
        self.note_real(interface.tolerance);
        let (mut fields, mut i) = (0, 0);
        while i < scalars.len() {
            fields += 1;
            i += scalars[i].variable.count();
        }
        self.note_number(fields);
        let mut i = 0;
        while i < scalars.len() {
            self.scalar(&scalars[i]);
            i += scalars[i].variable.count();
        }
        let (mut overrides, mut count) = (interface.overrides, 0);
        while let Some((_, rest)) = overrides.next() {
            overrides = rest;
            count += 1;
        }
        self.note_number(count);
        let mut overrides = interface.overrides;
        while let Some((first, rest)) = overrides.next() {
            self.value_of_variant(first);
            overrides = rest;
        }
    }

    const fn value_of_variant(
        &mut self,
        Override {
            reference,
            kind,
            text,
        }: Override<'_>,
    ) {
        self.note_number(reference as u128);
        self.note(&[kind]);
        self.note_bytes(text.as_bytes());
        self.identify_number(reference as u64);
        match kind {
            b'r' => self.identify_number(number(text, 16) as u64),
            b'i' => self.identify_number(number(text, 10) as u64),
            b'b' => self.identify(&[number(text, 10) as u8]),
            _ => self.identify_text(text),
        }
    }

    const fn scalar(&mut self, scalar: &Scalar) {
        let field = scalar.variable;
        let mut i = 0;
        while i < scalar.prefixes.len() {
            self.text(scalar.prefixes[i]);
            i += 1;
        }
        self.text(field.name);
        self.note_bytes(field.description.as_bytes());
        self.byte(field.causality as u8);
        self.byte(field.variability as u8);
        self.note_number(field.dimensions.len() as u128);
        self.identify_number(field.dimensions.len() as u64);
        let mut i = 0;
        while i < field.dimensions.len() {
            self.note_number(field.dimensions[i] as u128);
            self.identify_number(field.dimensions[i] as u64);
            i += 1;
        }
        self.text(field.size);
        match field.dynamics {
            Dynamics::Algebraic => self.byte(0),
            Dynamics::State { nominal } => {
                self.byte(1);
                self.note_real(nominal);
            }
            Dynamics::Derivative { of } => {
                self.byte(2);
                self.text(of);
            }
            Dynamics::EventIndicator => self.byte(3),
        }
        self.note(&[field.has_input_derivative as u8]);
        self.note_texts(field.initially_from);
        self.note_texts(field.depends_on);
        self.note_bytes(field.terminal.as_bytes());
        self.type_of(field);
        self.bounds(field.bounds);
        self.start(&field.start);
    }

    const fn type_of(&mut self, field: &Field) {
        let of_type = field.start.of_type();
        self.note(&[of_type as u8]);
        self.note_bytes(field.unit.as_bytes());
        self.note_bytes(field.mime_type.as_bytes());
        match field.start {
            Start::Float32(_) | Start::Float64(_) => {
                self.identify(&[0, matches!(of_type, Type::Float32) as u8]);
                self.identify_text(field.unit);
            }
            Start::Boolean(_) => self.identify(&[2]),
            Start::Enumeration(_, of) => {
                self.identify(&[3]);
                self.identify_text(of.name);
            }
            Start::String(_) => self.identify(&[4]),
            Start::Binary(_) => {
                self.identify(&[5]);
                self.identify_text(field.mime_type);
            }
            _ => self.identify(&[1, of_type as u8 - Type::Int8 as u8]),
        }
    }

    const fn bounds(&mut self, bounds: Bounds) {
        match bounds {
            Bounds::Real(min, max) => {
                self.note(&[0]);
                self.note_real(min);
                self.note_real(max);
                self.identify_number(min.to_bits());
                self.identify_number(max.to_bits());
            }
            Bounds::Whole(min, max) => {
                self.note(&[1]);
                self.note_whole(min);
                self.note_whole(max);
                self.identify_number(min as u64);
                self.identify_number(max as u64);
            }
            Bounds::None => self.note(&[2]),
        }
    }

    const fn start(&mut self, start: &Start) {
        self.note(&[match start {
            Start::Float32(_) | Start::Float64(_) => 0,
            Start::Boolean(_) => 2,
            Start::String(_) => 3,
            Start::Binary(_) => 4,
            _ => 1,
        }]);
        self.note_number(start.len() as u128);
        let mut i = 0;
        while i < start.len() {
            match start {
                Start::Float32(_) | Start::Float64(_) => {
                    self.note_real(start.real(i));
                    self.identify_number(start.real(i).to_bits());
                }
                Start::Boolean(values) => self.byte(values[i] as u8),
                Start::String(values) => self.text(values[i]),
                Start::Binary(values) => {
                    self.note_bytes(values[i]);
                    self.identify_number(values[i].len() as u64);
                    self.identify(values[i]);
                }
                _ => {
                    self.note_whole(start.whole(i));
                    self.identify_number(start.whole(i) as u64);
                }
            }
            i += 1;
        }
        let (name, description, items) = match start {
            Start::Enumeration(_, of) => (of.name, of.description, of.items),
            _ => ("", "", &[] as &[Item]),
        };
        self.note_bytes(name.as_bytes());
        self.note_bytes(description.as_bytes());
        self.note_number(items.len() as u128);
        let mut i = 0;
        while i < items.len() {
            self.text(items[i].name);
            self.note_whole(items[i].value as i128);
            self.identify_number(items[i].value as u64);
            self.note_bytes(items[i].description.as_bytes());
            i += 1;
        }
    }
}

/// `{xxxxxxxx-xxxx-8xxx-xxxx-xxxxxxxxxxxx}`: version 8 and the RFC 9562 variant.
const fn format(hash: u128) -> [u8; GUID_LENGTH] {
    const VERSION: u128 = 0xf << 76;
    const VARIANT: u128 = 0b11 << 62;
    let hash = hash & !VERSION & !VARIANT | 8 << 76 | 0b10 << 62;
    let mut text = *b"{00000000-0000-0000-0000-000000000000}";
    let mut digit = 0;
    let mut i = 0;
    while i < GUID_LENGTH {
        if text[i] == b'0' {
            let value = (hash >> (124 - 4 * digit)) as usize & 0xf;
            text[i] = b"0123456789abcdef"[value];
            digit += 1;
        }
        i += 1;
    }
    text
}
