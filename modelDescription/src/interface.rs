//! The interface of a model: its table with a name, its GUID, and its copy in the FMU binary.
//!
//! The copy is written at compile time and found by its first bytes, so that a binary for any platform can
//! be read without running it. Its format is postcard, so that serde reads it. The GUID is the hash of
//! the parts that make up the identity of the interface.

use crate::hash::{Hash, checksum};
use crate::scalar::{ScalarVariable, length};
use crate::table::{Bounds, Constant, Declaration, Dynamics, TypedStart, each};
use crate::{Causality, ClockType, Initial, Naming, OwnCategory, Type, Value, Variability};

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
    /// Whether it acts only at the ticks of its clocks.
    pub is_clocked: bool,
    /// Whether it simulates a bus, for the manifest of FMI-LS-BUS.
    pub is_bus_simulation: bool,
    /// Whether it has a log of its own.
    pub has_log: bool,
    /// The log categories that it declares.
    pub log_categories: &'static [OwnCategory],
    /// Whether its state cannot be saved.
    pub is_unsaved: bool,
    /// Whether a process can have one instance only.
    pub is_single_instance: bool,
    /// Whether its state cannot be serialized.
    pub is_unserialized: bool,
    /// How the names of variables are written.
    pub naming: Naming,
    /// The version or the code of the package, if it is part of the identity; empty otherwise.
    pub revision: &'static str,
    /// Stop time and communication step size (s) of the default experiment.
    pub default_experiment: (f64, f64),
    /// Relative tolerance of its integrator, also part of the default experiment; 0 if it has none.
    pub tolerance: f64,
    /// The names of the clocks at whose ticks a host activates the samples, if the binary is for scheduled execution:
    /// of the rates, or of the only sample time. They have the value references after all others.
    pub sample_clocks: &'static [&'static str],
    /// The first scalars of all variables, as [`scalars`](crate::scalar::scalars) returns them, with their value references.
    pub scalars: &'static [ScalarVariable],
    /// The value reference of the independent variable of FMI 3.0.
    pub time: usize,
    /// Start values that differ from the table.
    pub overrides: StartOverrides,
}

impl Interface {
    /// With the naming convention that the exporter chooses; see [`Naming::chosen`].
    pub const fn named(self, chosen: Option<&str>, of_model: Option<Naming>) -> Self {
        Self { naming: Naming::chosen(chosen, of_model), ..self }
    }

    /// With the revision that the exporter adds to the identity, if any.
    pub const fn revised(self, revision: Option<&'static str>) -> Self {
        match revision {
            Some(revision) => Self { revision, ..self },
            None => self,
        }
    }
}

/// Start values of a variant by value reference, in the text that the exporter passes to the compiler: for
/// each, `REFERENCE:LENGTH:VALUE`. A value is the bits of a real number as a whole number, a whole number or the
/// number of an item, 0 or 1, a text, or bytes as hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StartOverrides(&'static str);

/// A start value of a variant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StartOverride {
    /// The value reference of the variable.
    pub reference: usize,
    text: &'static str,
}

impl StartOverrides {
    /// No overrides.
    pub const NONE: Self = Self("");

    /// Whether there are none.
    pub const fn is_empty(self) -> bool {
        self.0.is_empty()
    }

    /// The name of a variant of the model `base`, and its start values, from the text
    /// `BASE=NAME;OVERRIDES`; `None` if it is a variant of another model.
    pub const fn parse(base: &str, text: &'static str) -> Option<(&'static str, Self)> {
        let (of, rest) = split(text, b'=');
        if Hash::new().bytes(of.as_bytes()).0 != Hash::new().bytes(base.as_bytes()).0 {
            return None;
        }
        let (name, overrides) = split(rest, b';');
        Some((name, Self(overrides)))
    }

    /// The first override, and those after it.
    pub const fn next(self) -> Option<(StartOverride, Self)> {
        if self.0.is_empty() {
            return None;
        }
        let (reference, rest) = split(self.0, b':');
        let (length, rest) = split(rest, b':');
        let (text, rest) = cut(rest, number(length, 10) as usize);
        let reference = number(reference, 10) as usize;
        Some((StartOverride { reference, text }, Self(rest)))
    }

    /// Whether it has some of so many variables.
    const fn has_any(mut self, from: usize, count: usize) -> bool {
        while let Some((first, rest)) = self.next() {
            if from <= first.reference && first.reference < from + count {
                return true;
            }
            self = rest;
        }
        false
    }

    /// The override of a variable, if there is one.
    const fn get(mut self, reference: usize) -> Option<StartOverride> {
        while let Some((first, rest)) = self.next() {
            if first.reference == reference {
                return Some(first);
            }
            self = rest;
        }
        None
    }
}

impl StartOverride {
    /// The value of a variable of a type.
    const fn constant(self, of_type: Type) -> Constant {
        match of_type {
            Type::Float32 | Type::Float64 => {
                Constant::Real(f64::from_bits(number(self.text, 10) as u64))
            }
            Type::Boolean => Constant::Boolean(number(self.text, 10) == 1),
            Type::String => Constant::Text(self.text),
            Type::Binary => Constant::Digits(self.text),
            _ => Constant::Whole(number(self.text, 10)),
        }
    }

    /// The type of the variable, or of the array of which it is an element.
    const fn of_type(&self, scalars: &[ScalarVariable]) -> Type {
        each!(scalar in scalars => {
            let first = scalar.reference;
            if first <= self.reference && self.reference < first + scalar.variable.element_count() {
                return scalar.variable.start.of_type();
            }
        });
        panic!("the overrides of a variant are damaged")
    }

    /// The value of a variable; `None` if its type does not have it.
    pub fn value(self, of_type: Type) -> Option<Value> {
        self.constant(of_type).value(of_type)
    }
}

/// The text of `BASE=NAME;OVERRIDES` for [`StartOverrides::parse`], from value references and values.
pub fn variant(base: &str, name: &str, overrides: &[(usize, Value)]) -> String {
    let overrides = overrides.iter().map(|(reference, value)| {
        let text = match (value, value.as_real()) {
            (_, Some(real)) => real.to_bits().to_string(),
            (Value::Boolean(value), _) => u8::from(*value).to_string(),
            _ => value.to_string(),
        };
        format!("{reference}:{}:{text}", text.len())
    });
    format!("{base}={name};{}", overrides.collect::<String>())
}

/// The parts of a text before and after a byte.
const fn split(text: &'static str, at: u8) -> (&'static str, &'static str) {
    let mut i = 0;
    while i < text.len() && text.as_bytes()[i] != at {
        i += 1;
    }
    let (before, rest) = cut(text, i);
    (before, cut(rest, 1).1)
}

/// The parts of a text before and after an index, which may be past its end.
const fn cut(text: &str, at: usize) -> (&str, &str) {
    match text.split_at_checked(at) {
        Some(parts) => parts,
        None => (text, ""),
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
pub(crate) const VERSION: u32 = 9;
/// Version of the format of copies that begin with a [`Supplement`](crate::exported::Supplement); those of models that
/// need none have the other version.
pub(crate) const SUPPLEMENTED: u32 = 10;
/// What is between the description of a deprecated variable and the text that says what to use instead.
pub(crate) const DEPRECATED: &str = " (deprecated: ";
/// Size of the checksum at the end of a copy.
pub(crate) const CHECKSUM: usize = size_of::<u128>();

/// The GUID of a model: the 128-bit FNV-1a hash of its name and its variables (names, order,
/// causality, variability, types, starts, bounds, units, part in equations, fixed value references), formatted as a version 8 UUID. It
/// is the same in every build and changes with the interface.
pub const fn guid(interface: &Interface) -> [u8; GUID_LENGTH] {
    let mut has_equations = false;
    each!(scalar in interface.scalars => {
        has_equations |= !matches!(scalar.variable.dynamics, Dynamics::Algebraic);
    });
    let mut hash =
        Hash::new().text(interface.name).bytes(&[interface.is_sampled as u8, has_equations as u8]);
    if interface.is_clocked {
        hash = hash.text("clocked");
    }
    if matches!(interface.naming, Naming::Flat) {
        hash = hash.text(interface.naming.as_str());
    }
    if !interface.revision.is_empty() {
        hash = hash.text("revision").text(interface.revision);
    }
    each!(clock in interface.sample_clocks => { hash = hash.text("sample clock").text(clock); });
    each!(scalar in interface.scalars => { hash = identify(scalar, hash); });
    let mut overrides = interface.overrides;
    while let Some((start, rest)) = overrides.next() {
        let of_type = start.of_type(interface.scalars);
        hash = hash.number(start.reference as u64);
        hash = identify_value(start.constant(of_type), hash);
        overrides = rest;
    }
    format(hash.0)
}

/// Adds the identity of a variable to a hash.
const fn identify(scalar: &ScalarVariable, mut hash: Hash) -> Hash {
    let field = scalar.variable;
    if scalar.reference != scalar.number {
        hash = hash.text("reference").number(scalar.reference as u64);
    }
    each!(prefix in scalar.prefixes => { hash = hash.text(prefix); });
    each!(alias in field.aliases() => { hash = hash.text("alias").text(alias); });
    hash = (hash.text(field.name))
        .bytes(&[field.causality as u8, field.variability as u8])
        .number(field.dimensions.len() as u64);
    each!(size in field.dimensions => { hash = hash.number(*size as u64); });
    hash = hash.text(field.size);
    hash = match field.dynamics {
        Dynamics::Algebraic => hash.bytes(&[0]),
        Dynamics::State => hash.bytes(&[1]),
        Dynamics::Derivative { of } => hash.bytes(&[2]).text(of),
        Dynamics::EventIndicator => hash.bytes(&[3]),
    };
    hash = match field.start {
        TypedStart::Float32(_) => hash.bytes(&[0, 1]).text(field.unit),
        TypedStart::Float64(_) => hash.bytes(&[0, 0]).text(field.unit),
        TypedStart::Boolean(_) => hash.bytes(&[2]),
        TypedStart::Enumeration(_, of) => hash.bytes(&[3]).text(of.name),
        TypedStart::String(_) => hash.bytes(&[4]),
        TypedStart::Binary(_) => hash.bytes(&[5]).text(field.mime_type),
        TypedStart::Clock(clock) => identify_clock(clock, hash.bytes(&[6])),
        _ => hash.bytes(&[1, field.start.of_type() as u8 - Type::Int8 as u8]),
    };
    hash = match field.bounds {
        Bounds::Real(min, max) => hash.number(min.to_bits()).number(max.to_bits()),
        Bounds::Whole(min, max) => hash.number(min as u64).number(max as u64),
        Bounds::Size(max) => hash.text("size").number(max as u64),
        Bounds::None => hash,
    };
    each!(clock in field.clocks => { hash = hash.text("clock").text(clock); });
    hash = identify_start(field, hash);
    each!(item in field.start.items() => {
        hash = hash.text(item.name).number(item.value as u64);
    });
    hash
}

/// Adds what says when a clock ticks to a hash.
const fn identify_clock(clock: &ClockType, hash: Hash) -> Hash {
    let interval = match clock.interval {
        Some(interval) => interval.to_bits(),
        None => 0,
    };
    let resolution = match clock.resolution {
        Some(resolution) => resolution,
        None => 0,
    };
    let priority = match clock.priority {
        Some(priority) => 1 + priority as u64,
        None => 0,
    };
    hash.bytes(&[clock.interval_variability as u8])
        .number(interval)
        .number(clock.shift.to_bits())
        .number(resolution)
        .number(priority)
}

/// Adds the start values of all elements to a hash.
const fn identify_start(field: &Declaration, mut hash: Hash) -> Hash {
    let (mut i, count) = (0, field.start_count());
    if field.start.len() == 1 {
        match field.start.get(0) {
            Constant::Real(number) => return hash.numbers(number.to_bits(), count),
            Constant::Whole(number) => return hash.numbers(number as u64, count),
            _ => {}
        }
    }
    while i < count {
        hash = identify_value(field.start.get(i), hash);
        i += 1;
    }
    hash
}

/// Adds a start value to a hash.
const fn identify_value(value: Constant, hash: Hash) -> Hash {
    match value {
        Constant::Real(number) => hash.number(number.to_bits()),
        Constant::Whole(number) => hash.number(number as u64),
        Constant::Boolean(value) => hash.bytes(&[value as u8]),
        Constant::Text(text) | Constant::Digits(text) => hash.text(text),
        Constant::Bytes(bytes) => hash.number(bytes.len() as u64).bytes(bytes),
    }
}

/// The GUID in a copy, which computes it only once; of the interface if there is no copy.
pub const fn guid_of_copy(copy: &[u8], interface: &Interface) -> [u8; GUID_LENGTH] {
    let end = copy.len().saturating_sub(CHECKSUM);
    match copy.split_at(end).0.last_chunk() {
        Some(guid) => *guid,
        None => guid(interface),
    }
}

/// Size of the copy of an interface in bytes.
pub const fn size(interface: &Interface) -> usize {
    write_copy::<0>(interface).length
}

/// The copy of an interface; `N` is its [`size`].
pub const fn write<const N: usize>(interface: &Interface) -> [u8; N] {
    let writer = write_copy::<N>(interface);
    assert!(writer.length == N, "N is the size of the copy");
    writer.bytes
}

const fn write_copy<const N: usize>(interface: &Interface) -> CopyWriter<N> {
    let mut writer = CopyWriter { bytes: [0; N], length: 0 };
    let supplemented = supplemented(interface);
    let has_supplement =
        interface.is_clocked || !interface.sample_clocks.is_empty() || supplemented > 0;
    writer.raw(&MAGIC);
    writer.raw(&if has_supplement { SUPPLEMENTED } else { VERSION }.to_le_bytes());
    // The first pass, which computes the length, does not know it.
    writer.raw(&(N as u32).to_le_bytes());
    if has_supplement {
        writer.supplement(interface, supplemented);
    }
    writer.description(interface);
    let (content, _) = writer.bytes.split_at(N.saturating_sub(CHECKSUM));
    let sum = checksum(content);
    writer.raw(&sum.to_le_bytes());
    writer
}

/// Number of the variables in the supplement of a copy.
const fn supplemented(interface: &Interface) -> usize {
    let mut count = 0;
    each!(scalar in interface.scalars => { count += is_supplemented(scalar.variable) as usize; });
    count
}

/// Whether the supplement of a copy has a variable.
const fn is_supplemented(field: &Declaration) -> bool {
    field.is_of_ticks() || matches!(field.bounds, Bounds::Size(_)) || !field.network.is_empty()
}

/// Writes a copy of `N` bytes, or counts the bytes if `N` is too small: a `ExportedModel`, as postcard reads it.
struct CopyWriter<const N: usize> {
    bytes: [u8; N],
    length: usize,
}

impl<const N: usize> CopyWriter<N> {
    const fn raw(&mut self, bytes: &[u8]) {
        let end = self.length + bytes.len();
        if end <= N {
            // Most bytes come in twos and threes, for which calls of functions would take the compiler longer.
            let mut i = 0;
            while i < bytes.len() {
                self.bytes[self.length + i] = bytes[i];
                i += 1;
            }
        }
        self.length = end;
    }

    /// Adds a whole number, seven bits a byte.
    const fn number(&mut self, mut number: u128) {
        while number > 0x7f {
            self.raw(&[number as u8 | 0x80]);
            number >>= 7;
        }
        self.raw(&[number as u8]);
    }

    /// Adds a whole number that may be negative.
    const fn signed(&mut self, number: i128) {
        self.number((number << 1 ^ number >> 127) as u128);
    }

    /// Adds bytes and their number.
    const fn text(&mut self, bytes: &[u8]) {
        self.number(bytes.len() as u128);
        self.raw(bytes);
    }

    /// Adds a text in parts.
    const fn parts(&mut self, parts: &[&str]) {
        self.number(length(parts) as u128);
        each!(part in parts => { self.raw(part.as_bytes()); });
    }

    /// Adds a text, or that there is none if it is empty.
    const fn some_text(&mut self, text: &str) {
        self.raw(&[!text.is_empty() as u8]);
        if !text.is_empty() {
            self.text(text.as_bytes());
        }
    }

    /// Adds a `Value` of a type.
    const fn value(&mut self, of_type: Type, value: Constant) {
        self.raw(&[of_type as u8]);
        match (value, of_type) {
            (Constant::Real(number), Type::Float32) => self.raw(&(number as f32).to_le_bytes()),
            (Constant::Real(number), _) => self.raw(&number.to_le_bytes()),
            (Constant::Whole(number), Type::Int8 | Type::UInt8) => self.raw(&[number as u8]),
            (Constant::Whole(number), Type::UInt16 | Type::UInt32 | Type::UInt64) => {
                self.number(number as u128);
            }
            (Constant::Whole(number), _) => self.signed(number),
            (Constant::Boolean(value), _) => self.raw(&[value as u8]),
            (Constant::Text(text), _) => self.text(text.as_bytes()),
            (Constant::Bytes(bytes), _) => self.text(bytes),
            (Constant::Digits(digits), _) => {
                self.number(digits.len() as u128 / 2);
                let mut rest = digits;
                while let Some((byte, others)) = rest.split_at_checked(2) {
                    self.raw(&[number(byte, 16) as u8]);
                    rest = others;
                }
            }
        }
    }

    const fn description(&mut self, interface: &Interface) {
        let Interface { scalars, .. } = *interface;
        self.text(interface.name.as_bytes());
        self.text(interface.description.as_bytes());
        self.raw(&[interface.is_sampled as u8, interface.is_continuous as u8]);
        self.raw(&[interface.has_log as u8]);
        self.number(interface.log_categories.len() as u128);
        each!(category in interface.log_categories => {
            self.text(category.name.to_bytes());
            self.text(category.description.as_bytes());
        });
        self.raw(&[interface.is_unsaved as u8]);
        self.raw(&[interface.is_single_instance as u8, interface.is_unserialized as u8]);
        self.raw(&[interface.naming as u8]);
        let (stop_time, step_size) = interface.default_experiment;
        self.raw(&stop_time.to_le_bytes());
        self.raw(&step_size.to_le_bytes());
        self.raw(&interface.tolerance.to_le_bytes());
        self.number(scalars.len() as u128);
        each!(scalar in scalars => { self.variable(scalar, interface); });
        self.number(interface.time as u128);
        // The first pass, which computes the length, saves the time.
        self.text(&if N == 0 { [0; GUID_LENGTH] } else { guid(interface) });
    }

    /// Adds a `Supplement` with so many variables.
    const fn supplement(&mut self, interface: &Interface, count: usize) {
        self.raw(&[interface.is_clocked as u8, interface.is_bus_simulation as u8]);
        self.number(interface.sample_clocks.len() as u128);
        each!(clock in interface.sample_clocks => { self.text(clock.as_bytes()); });
        self.number(count as u128);
        each!(scalar in interface.scalars => {
            let field = scalar.variable;
            if is_supplemented(field) {
                self.number(scalar.reference as u128);
                self.references(field.clocks, scalar, interface.scalars);
                match field.bounds {
                    Bounds::Size(max) => self.some_number(Some(max as u64)),
                    _ => self.some_number(None),
                }
                match field.start.clock() {
                    Some(clock) => self.clock(clock),
                    None => self.raw(&[0]),
                }
                self.raw(&[!field.network.is_empty() as u8]);
                if !field.network.is_empty() {
                    self.parts(&scalar.group_parts());
                    self.text(field.network.as_bytes());
                }
            }
        });
    }

    /// Adds a `ClockType`.
    const fn clock(&mut self, clock: &ClockType) {
        self.raw(&[1, clock.interval_variability as u8]);
        match clock.interval {
            Some(interval) => {
                self.raw(&[1]);
                self.raw(&interval.to_le_bytes());
            }
            None => self.raw(&[0]),
        }
        self.raw(&clock.shift.to_le_bytes());
        self.some_number(clock.resolution);
        self.raw(&[clock.supports_fraction as u8]);
        self.some_number(match clock.priority {
            Some(priority) => Some(priority as u64),
            None => None,
        });
        self.raw(&[clock.can_be_deactivated as u8]);
    }

    /// Adds a whole number, or that there is none.
    const fn some_number(&mut self, number: Option<u64>) {
        self.raw(&[number.is_some() as u8]);
        if let Some(number) = number {
            self.number(number as u128);
        }
    }

    /// Adds a `Variable`.
    const fn variable(&mut self, scalar: &ScalarVariable, interface: &Interface) {
        let scalars = interface.scalars;
        let (field, reference) = (scalar.variable, scalar.reference);
        self.parts(&scalar.name_parts());
        self.aliases(scalar, scalars);
        self.number(reference as u128);
        match field.deprecated() {
            instead if instead.is_empty() => self.text(field.description.as_bytes()),
            instead => self.parts(&[field.description, DEPRECATED, instead, ")"]),
        }
        // Outputs of a model with a sample time change at its sample instants only.
        let is_held =
            interface.is_sampled && matches!(field.causality, Causality::Output | Causality::Local);
        let variability = match field.variability {
            Variability::Continuous if is_held => Variability::Discrete,
            variability => variability,
        };
        self.raw(&[field.causality as u8, variability as u8]);
        match Initial::default_for(field.causality, variability) {
            // A clock has no initial value.
            _ if field.start.clock().is_some() => self.raw(&[0]),
            Some(Initial::Calculated) if !field.start.is_empty() => {
                self.raw(&[1, Initial::Exact as u8]);
            }
            Some(initial) => self.raw(&[1, initial as u8]),
            None => self.raw(&[0]),
        }
        self.number(field.dimensions.len() as u128);
        each!(size in field.dimensions => { self.number(*size as u128); });
        self.exported(scalar, scalars);
        self.raw(&[field.start.of_type() as u8]);
        self.some_text(field.unit);
        self.some_text(field.display_unit);
        self.some_text(field.mime_type);
        self.bounds(field);
        self.start(field, reference, interface.overrides);
        self.declared_type(&field.start);
    }

    /// Adds the former names of a variable; the derivative of a state has them from the state.
    const fn aliases(&mut self, scalar: &ScalarVariable, scalars: &[ScalarVariable]) {
        let (of, start, end) = match scalar.variable.dynamics {
            Dynamics::Derivative { of } => {
                (scalars[scalar.position(of, scalars)].variable, "der(", ")")
            }
            _ => (scalar.variable, "", ""),
        };
        self.number(of.aliases().len() as u128);
        each!(alias in of.aliases() => {
            let name = scalar.parts_of(alias);
            self.number((start.len() + length(&name) + end.len()) as u128);
            self.raw(start.as_bytes());
            each!(part in name => { self.raw(part.as_bytes()); });
            self.raw(end.as_bytes());
        });
    }

    const fn exported(&mut self, scalar: &ScalarVariable, scalars: &[ScalarVariable]) {
        let field = scalar.variable;
        self.raw(&[field.has_input_derivative as u8]);
        match field.dynamics {
            Dynamics::Algebraic => self.raw(&[0]),
            Dynamics::State => self.raw(&[1]),
            Dynamics::Derivative { of } => {
                self.raw(&[2]);
                self.reference(of, scalar, scalars);
            }
            Dynamics::EventIndicator => self.raw(&[3]),
        }
        self.raw(&field.nominal.to_le_bytes());
        match field.size.is_empty() {
            true => self.raw(&[0]),
            false => {
                self.raw(&[1]);
                self.reference(field.size, scalar, scalars);
            }
        }
        match field.initially_from {
            None => self.raw(&[0]),
            Some(names) => {
                self.raw(&[1]);
                self.references(names, scalar, scalars);
            }
        }
        self.references(field.depends_on, scalar, scalars);
        self.text(field.terminal.as_bytes());
    }

    const fn references(
        &mut self,
        names: &[&str],
        scalar: &ScalarVariable,
        scalars: &[ScalarVariable],
    ) {
        self.number(names.len() as u128);
        each!(name in names => { self.reference(name, scalar, scalars); });
    }

    /// Adds the value reference of another variable in the group of a variable.
    const fn reference(&mut self, name: &str, scalar: &ScalarVariable, scalars: &[ScalarVariable]) {
        self.number(scalars[scalar.position(name, scalars)].reference as u128);
    }

    /// Adds the smallest and the largest value, or none if the type has the same.
    const fn bounds(&mut self, field: &Declaration) {
        let of_type = field.start.of_type();
        let both = match (field.bounds, field.start) {
            (Bounds::None, TypedStart::Enumeration(_, of)) => of.bounds(),
            (bounds, _) => bounds,
        };
        let (low, high) = of_type.range();
        each!(i, limit in [low, high] => {
            let bound = match both {
                Bounds::Real(min, max) if [min, max][i].is_finite() => Constant::Real([min, max][i]),
                Bounds::Whole(min, max) if [min, max][i] != *limit => Constant::Whole([min, max][i]),
                _ => {
                    self.raw(&[0]);
                    continue;
                }
            };
            self.raw(&[1]);
            self.value(of_type, bound);
        });
    }

    /// Adds the start values, one if all elements have the same; a variant replaces some.
    const fn start(&mut self, field: &Declaration, reference: usize, overrides: StartOverrides) {
        let (start, of_type) = (&field.start, field.start.of_type());
        let is_replaced = overrides.has_any(reference, field.start_count());
        let count = if is_replaced { field.start_count() } else { start.len() };
        self.number(count as u128);
        let mut i = 0;
        while i < count {
            let value = match overrides.get(reference + i) {
                Some(start) => start.constant(of_type),
                None => start.get(i),
            };
            self.value(of_type, value);
            i += 1;
        }
    }

    const fn declared_type(&mut self, start: &TypedStart) {
        let TypedStart::Enumeration(_, of) = start else { return self.raw(&[0]) };
        self.raw(&[1]);
        self.text(of.name.as_bytes());
        self.text(of.description.as_bytes());
        self.number(of.items.len() as u128);
        each!(item in of.items => {
            self.text(item.name.as_bytes());
            self.signed(item.value as i128);
            self.text(item.description.as_bytes());
        });
    }
}

/// `{xxxxxxxx-xxxx-8xxx-xxxx-xxxxxxxxxxxx}`: version 8 and the RFC 9562 variant.
const fn format(hash: u128) -> [u8; GUID_LENGTH] {
    const VERSION: u128 = 0xf << 76;
    const VARIANT: u128 = 0b11 << 62;
    let hash = hash & !VERSION & !VARIANT | 8 << 76 | 0b10 << 62;
    const ZERO: [u8; GUID_LENGTH] = *b"{00000000-0000-0000-0000-000000000000}";
    let (mut text, mut digit) = (ZERO, 0);
    each!(i, zero in ZERO => {
        if *zero == b'0' {
            let value = (hash >> (124 - 4 * digit)) as usize & 0xf;
            text[i] = b"0123456789abcdef"[value];
            digit += 1;
        }
    });
    text
}
