//! The interface of a model: its table with a name, and start values that a variant overrides.

use crate::Scalar;

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

/// A start value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StartValue<'a> {
    /// Of a Real.
    Real(f64),
    /// Of a whole number, or the number of an item of an enumeration.
    Integer(i128),
    /// Of a Boolean.
    Boolean(bool),
    /// Of a String.
    String(&'a str),
    /// Of a Binary.
    Binary(Hexadecimal<'a>),
}

/// Bytes as hexadecimal digits, two for each byte.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hexadecimal<'a>(pub(crate) &'a str);

impl<'a> Hexadecimal<'a> {
    /// Checks the digits.
    pub fn parse(digits: &'a str) -> Option<Self> {
        let is_valid =
            digits.len().is_multiple_of(2) && digits.bytes().all(|c| c.is_ascii_hexdigit());
        is_valid.then_some(Self(digits))
    }

    /// The bytes.
    pub fn bytes(self) -> impl Iterator<Item = u8> + 'a {
        let digit = |c: u8| char::from(c).to_digit(16).unwrap_or_default() as u8;
        let (pairs, _) = self.0.as_bytes().as_chunks();
        pairs
            .iter()
            .map(move |[high, low]| digit(*high) << 4 | digit(*low))
    }
}

/// Start values by value reference, in the text that the exporter passes to the compiler: for each,
/// `REFERENCE:TYPE LENGTH:VALUE` without spaces, where the type is `r`, `i`, `b`, `s` or `x`, and the
/// value of a Real is written as 16 hexadecimal digits, its bits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overrides(&'static str);

impl Overrides {
    /// No overrides.
    pub const NONE: Self = Self("");

    /// The name of a variant of the model `base`, and its start values, from the text
    /// `BASE=NAME;OVERRIDES`; `None` if it is a variant of another model.
    pub const fn of(base: &str, text: &'static str) -> Option<(&'static str, Self)> {
        let (of, rest) = split(text, b'=');
        if !equal(of.as_bytes(), base.as_bytes()) {
            return None;
        }
        let (name, overrides) = split(rest, b';');
        Some((name, Self(overrides)))
    }

    /// The first override, and those after it.
    pub const fn next(self) -> Option<((usize, StartValue<'static>), Self)> {
        if self.0.is_empty() {
            return None;
        }
        let (reference, rest) = split(self.0, b':');
        let (kind, rest) = rest.split_at(1);
        let (length, rest) = split(rest, b':');
        let (value, rest) = rest.split_at(number(length) as usize);
        let value = match kind.as_bytes()[0] {
            b'r' => StartValue::Real(f64::from_bits(hexadecimal(value))),
            b'i' => StartValue::Integer(number(value)),
            b'x' => StartValue::Binary(Hexadecimal(value)),
            b'b' => StartValue::Boolean(number(value) == 1),
            _ => StartValue::String(value),
        };
        Some(((number(reference) as usize, value), Self(rest)))
    }
}

/// The text of `BASE=NAME;OVERRIDES` for [`Overrides::of`].
pub fn variant(base: &str, name: &str, overrides: &[(usize, StartValue<'_>)]) -> String {
    let overrides: String = overrides
        .iter()
        .map(|(reference, value)| {
            let (kind, text) = match value {
                StartValue::Real(value) => ('r', format!("{:016x}", value.to_bits())),
                StartValue::Integer(value) => ('i', value.to_string()),
                StartValue::Boolean(value) => ('b', u8::from(*value).to_string()),
                StartValue::String(value) => ('s', (*value).to_owned()),
                StartValue::Binary(value) => ('x', value.0.to_owned()),
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

const fn number(text: &str) -> i128 {
    match i128::from_str_radix(text, 10) {
        Ok(number) => number,
        Err(_) => panic!("the overrides of a variant are damaged"),
    }
}

const fn hexadecimal(text: &str) -> u64 {
    match u64::from_str_radix(text, 16) {
        Ok(bits) => bits,
        Err(_) => panic!("the overrides of a variant are damaged"),
    }
}

pub(crate) const fn equal(a: &[u8], b: &[u8]) -> bool {
    if a.len() != b.len() {
        return false;
    }
    let mut i = 0;
    while i < a.len() {
        if a[i] != b[i] {
            return false;
        }
        i += 1;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overrides_survive_the_way_through_the_compiler() {
        let overrides = [
            (6, StartValue::Real(0.1)),
            (7, StartValue::Integer(-3)),
            (8, StartValue::Boolean(true)),
            (9, StartValue::String("a:b;c=\u{e9}")),
            (10, StartValue::String("")),
            (11, StartValue::Integer(u64::MAX.into())),
            (
                12,
                StartValue::Binary(Hexadecimal::parse("00fF7e").unwrap()),
            ),
        ];
        let text: &'static str = Box::leak(variant("Pid", "Fast", &overrides).into_boxed_str());
        assert!(Overrides::of("Pi", text).is_none());
        let (name, mut rest) = Overrides::of("Pid", text).unwrap();
        assert_eq!(name, "Fast");
        for expected in overrides {
            let (found, others) = rest.next().unwrap();
            assert_eq!(found, expected);
            rest = others;
        }
        assert_eq!(rest.next(), None);
    }

    #[test]
    fn hexadecimal_digits_are_bytes() {
        let bytes = Hexadecimal::parse("00fF7e").unwrap().bytes();
        assert_eq!(bytes.collect::<Vec<_>>(), [0x00, 0xff, 0x7e]);
        for bad in ["f", "0g", "+1", "\u{e9}"] {
            assert_eq!(Hexadecimal::parse(bad), None);
        }
    }
}
