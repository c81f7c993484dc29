//! The copy of a model's interface in its FMU binary, from which the exporter generates the XML. It is
//! written at compile time and found by its first bytes, so that a binary for any platform can be read
//! without running it.

use crate::guid::{LENGTH, checksum, guid};
use crate::table::{Domain, Dynamics, Scalar, Variable};
use crate::{Interface, StartValue};

/// The first bytes of a copy.
const MAGIC: [u8; 16] = *b"\x7fFMU-INTERFACE\x7f\n";
/// Version of the format; increase it when the format changes.
pub const VERSION: u32 = 4;
/// Size of the checksum at the end.
const CHECKSUM: usize = size_of::<u128>();

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
    };
    writer.bytes(&MAGIC);
    writer.number(VERSION);
    // The first pass, which computes the length, does not know it.
    writer.number(N as u32);
    writer.interface(interface);
    let (content, _) = writer.bytes.split_at(N.saturating_sub(CHECKSUM));
    let sum = checksum(content);
    writer.bytes(&sum.to_le_bytes());
    writer
}

/// Writes the first `N` bytes, and counts the others.
struct Writer<const N: usize> {
    bytes: [u8; N],
    length: usize,
}

impl<const N: usize> Writer<N> {
    const fn byte(&mut self, byte: u8) {
        if self.length < N {
            self.bytes[self.length] = byte;
        }
        self.length += 1;
    }

    const fn bytes(&mut self, bytes: &[u8]) {
        let mut i = 0;
        while i < bytes.len() {
            self.byte(bytes[i]);
            i += 1;
        }
    }

    const fn number(&mut self, number: u32) {
        self.bytes(&number.to_le_bytes());
    }

    const fn real(&mut self, value: f64) {
        self.bytes(&value.to_bits().to_le_bytes());
    }

    const fn integer(&mut self, value: i128) {
        self.bytes(&value.to_le_bytes());
    }

    const fn text(&mut self, text: &str) {
        self.block(text.as_bytes());
    }

    /// Bytes and their number.
    const fn block(&mut self, bytes: &[u8]) {
        self.number(bytes.len() as u32);
        self.bytes(bytes);
    }

    const fn interface(&mut self, interface: &Interface) {
        self.text(interface.name);
        self.text(interface.description);
        // The pass that only counts need not compute it.
        let guid: [u8; LENGTH] = if N > 0 { guid(interface) } else { [0; LENGTH] };
        self.bytes(&guid);
        self.byte(interface.is_sampled as u8);
        self.byte(interface.is_continuous as u8);
        self.real(interface.default_experiment.0);
        self.real(interface.default_experiment.1);
        self.real(interface.tolerance);
        let scalars = interface.scalars;
        self.number(scalars.len() as u32);
        let mut i = 0;
        while i < scalars.len() {
            if scalars[i].element == 0 {
                self.variable(&scalars[i], scalars);
            }
            i += 1;
        }
        let mut overrides = interface.overrides;
        while let Some(((reference, value), rest)) = overrides.next() {
            self.number(reference as u32);
            match value {
                StartValue::Real(value) => self.real(value),
                StartValue::Integer(value) => self.integer(value),
                StartValue::Binary(value) => self.text(value.0),
                StartValue::Boolean(value) => self.byte(value as u8),
                StartValue::String(value) => self.text(value),
            }
            overrides = rest;
        }
    }

    const fn variable(&mut self, scalar: &Scalar, scalars: &[Scalar]) {
        let Variable {
            name,
            description,
            offset: _,
            causality,
            variability,
            dimensions,
            size: _,
            domain,
            initially_from,
            dynamics,
            depends_on,
            has_input_derivative,
            terminal,
        } = scalar.variable;
        let mut i = 0;
        while i < scalar.prefixes.len() {
            self.text(scalar.prefixes[i]);
            i += 1;
        }
        self.text(name);
        self.text(description);
        self.byte(*causality as u8);
        self.byte(*variability as u8);
        self.byte(*has_input_derivative as u8);
        match dynamics {
            Dynamics::Algebraic => self.byte(0),
            Dynamics::State { nominal } => {
                self.byte(1);
                self.real(*nominal);
            }
            Dynamics::Derivative { of } => {
                self.byte(2);
                self.number(scalar.position(of, scalars) as u32);
            }
            Dynamics::EventIndicator => self.byte(3),
        }
        self.number(dimensions.len() as u32);
        let mut i = 0;
        while i < dimensions.len() {
            self.number(dimensions[i] as u32);
            i += 1;
        }
        match scalar.size(scalars) {
            Some(size) => {
                self.byte(1);
                self.number(size as u32);
            }
            None => self.byte(0),
        }
        self.references(scalar, initially_from, scalars);
        self.references(scalar, depends_on, scalars);
        self.text(terminal);
        self.domain(domain);
    }

    /// The value references of variables in the same group as the scalar.
    const fn references(&mut self, scalar: &Scalar, names: &[&str], scalars: &[Scalar]) {
        self.number(names.len() as u32);
        let mut i = 0;
        while i < names.len() {
            self.number(scalar.position(names[i], scalars) as u32);
            i += 1;
        }
    }

    const fn domain(&mut self, domain: &Domain) {
        match domain {
            Domain::Real {
                start,
                min,
                max,
                unit,
            } => {
                self.byte(0);
                self.byte(start.are_single() as u8);
                self.real(*min);
                self.real(*max);
                self.text(unit);
                self.number(start.len() as u32);
                let mut i = 0;
                while i < start.len() {
                    self.real(start.get(i));
                    i += 1;
                }
            }
            Domain::Integer { start, min, max } => {
                self.byte(1);
                self.byte(start.kind() as u8);
                self.integer(*min);
                self.integer(*max);
                self.number(start.len() as u32);
                let mut i = 0;
                while i < start.len() {
                    self.integer(start.get(i));
                    i += 1;
                }
            }
            Domain::Boolean { start } => {
                self.byte(2);
                self.number(start.len() as u32);
                let mut i = 0;
                while i < start.len() {
                    self.byte(start[i] as u8);
                    i += 1;
                }
            }
            Domain::String { start } => {
                self.byte(3);
                self.number(start.len() as u32);
                let mut i = 0;
                while i < start.len() {
                    self.text(start[i]);
                    i += 1;
                }
            }
            Domain::Enumeration { start, items } => {
                self.byte(4);
                self.text(items.name);
                self.text(items.description);
                self.number(items.items.len() as u32);
                let mut i = 0;
                while i < items.items.len() {
                    self.number(items.items[i].value as u32);
                    self.text(items.items[i].name);
                    self.text(items.items[i].description);
                    i += 1;
                }
                self.number(start.len() as u32);
                let mut i = 0;
                while i < start.len() {
                    self.number(start[i] as u32);
                    i += 1;
                }
            }
            Domain::Binary { start, mime_type } => {
                self.byte(5);
                self.text(mime_type);
                self.number(start.len() as u32);
                let mut i = 0;
                while i < start.len() {
                    self.block(start[i]);
                    i += 1;
                }
            }
        }
    }
}

#[cfg(feature = "xml")]
pub use read::read;

#[cfg(feature = "xml")]
mod read {
    use anyhow::{Context, Result, bail, ensure};

    use super::{CHECKSUM, Dynamics, LENGTH, MAGIC, VERSION, checksum};
    use crate::describe::{Description, Type, VariableDescription};
    use crate::table::{MAX_DEPTH, joined};
    use crate::{Causality, Hexadecimal, IntegerKind, Variability};

    /// Reads the interfaces of all models in a binary, without duplicates: a universal binary has
    /// several copies of each.
    ///
    /// # Errors
    /// A copy is damaged, or of another version of the format.
    pub fn read(binary: &[u8]) -> Result<Vec<Description>> {
        let mut models = Vec::new();
        let mut rest = binary;
        while let Some(at) = find(rest) {
            let copy = &rest[at..];
            let mut reader = Reader(&copy[MAGIC.len()..]);
            let version = reader.item()? as u32;
            ensure!(
                version == VERSION,
                "the library was built with another version of fmu-export: its format is {version}, expected {VERSION}"
            );
            let length = reader.number()?;
            let (copy, after) = copy.split_at_checked(length).context(DAMAGED)?;
            let model = description(copy).context(DAMAGED)?;
            if !models.contains(&model) {
                models.push(model);
            }
            rest = after;
        }
        Ok(models)
    }

    const DAMAGED: &str = "the description of a model in the binary is damaged";

    /// Reads a copy.
    fn description(copy: &[u8]) -> Result<Description> {
        let (content, sum) = copy
            .split_last_chunk::<CHECKSUM>()
            .context("it ends too early")?;
        ensure!(
            checksum(content).to_le_bytes() == *sum,
            "its checksum is wrong"
        );
        let header = MAGIC.len() + 2 * size_of::<u32>();
        Reader(content.get(header..).unwrap_or_default()).description()
    }

    fn find(bytes: &[u8]) -> Option<usize> {
        let mut from = 0;
        loop {
            let start = bytes[from..].iter().position(|&byte| byte == MAGIC[0])?;
            from += start;
            if bytes[from..].starts_with(&MAGIC) {
                return Some(from);
            }
            from += 1;
        }
    }

    struct Reader<'a>(&'a [u8]);

    impl<'a> Reader<'a> {
        fn bytes(&mut self, count: usize) -> Result<&'a [u8]> {
            let (bytes, rest) = self
                .0
                .split_at_checked(count)
                .context("it ends too early")?;
            self.0 = rest;
            Ok(bytes)
        }

        fn byte(&mut self) -> Result<u8> {
            Ok(self.bytes(1)?[0])
        }

        fn flag(&mut self) -> Result<bool> {
            Ok(self.byte()? != 0)
        }

        fn number(&mut self) -> Result<usize> {
            Ok(self.item()? as u32 as usize)
        }

        /// The number of an item of an enumeration.
        fn item(&mut self) -> Result<i32> {
            Ok(i32::from_le_bytes(self.bytes(4)?.try_into()?))
        }

        fn integer(&mut self) -> Result<i128> {
            Ok(i128::from_le_bytes(self.bytes(16)?.try_into()?))
        }

        fn real(&mut self) -> Result<f64> {
            Ok(f64::from_le_bytes(self.bytes(8)?.try_into()?))
        }

        fn text(&mut self) -> Result<String> {
            Ok(String::from_utf8(self.block()?)?)
        }

        fn block(&mut self) -> Result<Vec<u8>> {
            let length = self.number()?;
            Ok(self.bytes(length)?.to_vec())
        }

        fn list<T>(&mut self, mut item: impl FnMut(&mut Self) -> Result<T>) -> Result<Vec<T>> {
            (0..self.number()?).map(|_| item(self)).collect()
        }

        fn description(&mut self) -> Result<Description> {
            let mut description = Description {
                name: self.text()?,
                description: self.text()?,
                guid: String::from_utf8(self.bytes(LENGTH)?.to_vec())?,
                is_sampled: self.flag()?,
                is_continuous: self.flag()?,
                default_experiment: (self.real()?, self.real()?),
                tolerance: self.real()?,
                variables: Vec::new(),
            };
            let count = self.number()?;
            let mut scalars = 0;
            while scalars < count {
                let variable = self.variable(description.is_sampled)?;
                let size = (variable.dimensions.iter())
                    .try_fold(1, |size: usize, n| size.checked_mul(*n))
                    .filter(|size| (1..=count - scalars).contains(size))
                    .with_context(|| format!("the size of {} is invalid", variable.name))?;
                scalars += size;
                description.variables.push(variable);
            }
            while !self.0.is_empty() {
                let reference = self.number()?;
                let (variable, element) = description
                    .variable_mut(reference)
                    .context("an override has an unknown value reference")?;
                self.start(&mut variable.of_type, element)?;
            }
            Ok(description)
        }

        fn variable(&mut self, is_sampled: bool) -> Result<VariableDescription> {
            let prefixes = (0..MAX_DEPTH)
                .map(|_| self.text())
                .collect::<Result<Vec<_>>>()?;
            let name = joined(&prefixes, &self.text()?);
            let description = self.text()?;
            let causality = *Causality::ALL
                .get(usize::from(self.byte()?))
                .context("unknown causality")?;
            let variability = *Variability::ALL
                .get(usize::from(self.byte()?))
                .context("unknown variability")?;
            let is_discrete = is_sampled
                && variability == Variability::Continuous
                && matches!(causality, Causality::Output | Causality::Local);
            Ok(VariableDescription {
                name,
                description,
                causality,
                variability: match is_discrete {
                    true => Variability::Discrete,
                    false => variability,
                },
                has_input_derivative: self.flag()?,
                dynamics: self.dynamics()?,
                dimensions: self.list(Self::number)?,
                size: self.flag()?.then(|| self.number()).transpose()?,
                initially_from: self.list(Self::number)?,
                depends_on: self.list(Self::number)?,
                terminal: self.text()?,
                of_type: self.of_type()?,
            })
        }

        fn dynamics(&mut self) -> Result<Dynamics<usize>> {
            Ok(match self.byte()? {
                0 => Dynamics::Algebraic,
                1 => Dynamics::State {
                    nominal: self.real()?,
                },
                2 => Dynamics::Derivative { of: self.number()? },
                3 => Dynamics::EventIndicator,
                unknown => bail!("unknown dynamics {unknown}"),
            })
        }

        fn of_type(&mut self) -> Result<Type> {
            Ok(match self.byte()? {
                0 => Type::Real {
                    single: self.flag()?,
                    min: self.real()?,
                    max: self.real()?,
                    unit: self.text()?,
                    start: self.list(Self::real)?,
                },
                1 => Type::Integer {
                    kind: *IntegerKind::ALL
                        .get(usize::from(self.byte()?))
                        .context("unknown integer type")?,
                    min: self.integer()?,
                    max: self.integer()?,
                    start: self.list(Self::integer)?,
                },
                2 => Type::Boolean {
                    start: self.list(Self::flag)?,
                },
                3 => Type::String {
                    start: self.list(Self::text)?,
                },
                4 => Type::Enumeration {
                    name: self.text()?,
                    description: self.text()?,
                    items: self
                        .list(|reader| Ok((reader.item()?, reader.text()?, reader.text()?)))?,
                    start: self.list(Self::item)?,
                },
                5 => Type::Binary {
                    mime_type: self.text()?,
                    start: self.list(Self::block)?,
                },
                unknown => bail!("unknown type {unknown}"),
            })
        }

        /// Reads a value that overrides a start value.
        fn start(&mut self, of_type: &mut Type, element: usize) -> Result<()> {
            const MISSING: &str = "an override of a variable without a start value";
            match of_type {
                Type::Real { start, .. } => {
                    *start.get_mut(element).context(MISSING)? = self.real()?;
                }
                Type::Integer { start, .. } => {
                    *start.get_mut(element).context(MISSING)? = self.integer()?;
                }
                Type::Enumeration { start, .. } => {
                    *start.get_mut(element).context(MISSING)? = self.integer()?.try_into()?;
                }
                Type::Binary { start, .. } => {
                    let text = self.text()?;
                    let digits = Hexadecimal::parse(&text).context("invalid digits")?;
                    *start.get_mut(element).context(MISSING)? = digits.bytes().collect();
                }
                Type::Boolean { start } => {
                    *start.get_mut(element).context(MISSING)? = self.flag()?;
                }
                Type::String { start } => {
                    *start.get_mut(element).context(MISSING)? = self.text()?;
                }
            }
            Ok(())
        }
    }
}
