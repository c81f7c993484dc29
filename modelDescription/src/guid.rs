//! The identity of an interface, computed at compile time.

use crate::{Domain, Dynamics, Interface, Scalar, StartValue};

/// Length of a GUID as text, including the braces.
pub const LENGTH: usize = 38;

/// The GUID of a model: the 128-bit FNV-1a hash of its name and its variables (names, order,
/// causality, variability, types, starts, bounds, units), formatted as a version 8 UUID. It is the
/// same in every build and changes with the interface.
pub const fn guid(interface: &Interface) -> [u8; LENGTH] {
    let mut hash = Hash::new()
        .text(interface.name)
        .byte(interface.is_sampled as u8)
        .byte(interface.is_continuous as u8);
    let mut i = 0;
    while i < interface.scalars.len() {
        hash = hash.scalar(&interface.scalars[i]);
        i += 1;
    }
    let mut overrides = interface.overrides;
    while let Some(((reference, value), rest)) = overrides.next() {
        hash = hash.number(reference as u64);
        hash = match value {
            StartValue::Real(value) => hash.number(value.to_bits()),
            StartValue::Integer(value) => hash.number(value as u64),
            StartValue::Binary(value) => hash.text(value.0),
            StartValue::Boolean(value) => hash.byte(value as u8),
            StartValue::String(value) => hash.text(value),
        };
        overrides = rest;
    }
    format(hash.0)
}

/// The 128-bit FNV-1a hash of bytes, to detect corruption.
pub const fn checksum(bytes: &[u8]) -> u128 {
    Hash::new().bytes(bytes).0
}

/// FNV-1a, 128 bits.
#[derive(Clone, Copy)]
pub(crate) struct Hash(pub(crate) u128);

impl Hash {
    pub(crate) const fn new() -> Self {
        Self(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d)
    }

    pub(crate) const fn byte(self, byte: u8) -> Self {
        Self((self.0 ^ byte as u128).wrapping_mul(0x0000_0000_0100_0000_0000_0000_0000_013b))
    }

    pub(crate) const fn bytes(mut self, bytes: &[u8]) -> Self {
        let mut i = 0;
        while i < bytes.len() {
            self = self.byte(bytes[i]);
            i += 1;
        }
        self
    }

    /// A prefix of a name, unless it is empty.
    pub(crate) const fn prefix(self, prefix: &str) -> Self {
        match prefix.is_empty() {
            true => self,
            false => self.bytes(prefix.as_bytes()).byte(b'.'),
        }
    }

    /// A text and a terminator, so that "a", "bc" differs from "ab", "c".
    const fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes()).byte(0xff)
    }

    const fn number(self, number: u64) -> Self {
        self.bytes(&number.to_le_bytes())
    }

    /// A scalar; the variable of an array is included with its first element.
    const fn scalar(mut self, scalar: &Scalar) -> Self {
        let variable = scalar.variable;
        if scalar.element > 0 {
            return self;
        }
        let mut i = 0;
        while i < scalar.prefixes.len() {
            self = self.text(scalar.prefixes[i]);
            i += 1;
        }
        self = self
            .text(variable.name)
            .byte(variable.causality as u8)
            .byte(variable.variability as u8)
            .number(variable.dimensions.len() as u64);
        let mut i = 0;
        while i < variable.dimensions.len() {
            self = self.number(variable.dimensions[i] as u64);
            i += 1;
        }
        self = self.text(variable.size);
        self = match variable.dynamics {
            Dynamics::Algebraic => self.byte(0),
            Dynamics::State { .. } => self.byte(1),
            Dynamics::Derivative { of } => self.byte(2).text(of),
            Dynamics::EventIndicator => self.byte(3),
        };
        self.domain(&variable.domain)
    }

    const fn domain(self, domain: &Domain) -> Self {
        match domain {
            Domain::Real {
                start,
                min,
                max,
                unit,
            } => {
                let mut hash = self
                    .byte(0)
                    .byte(start.are_single() as u8)
                    .text(unit)
                    .number(min.to_bits())
                    .number(max.to_bits());
                let mut i = 0;
                while i < start.len() {
                    hash = hash.number(start.get(i).to_bits());
                    i += 1;
                }
                hash
            }
            Domain::Integer { start, min, max } => {
                let mut hash = self
                    .byte(1)
                    .byte(start.kind() as u8)
                    .number(*min as u64)
                    .number(*max as u64);
                let mut i = 0;
                while i < start.len() {
                    hash = hash.number(start.get(i) as u64);
                    i += 1;
                }
                hash
            }
            Domain::Boolean { start } => {
                let mut hash = self.byte(2);
                let mut i = 0;
                while i < start.len() {
                    hash = hash.byte(start[i] as u8);
                    i += 1;
                }
                hash
            }
            Domain::String { start } => {
                let mut hash = self.byte(4);
                let mut i = 0;
                while i < start.len() {
                    hash = hash.text(start[i]);
                    i += 1;
                }
                hash
            }
            Domain::Binary { start, mime_type } => {
                let mut hash = self.byte(5).text(mime_type);
                let mut i = 0;
                while i < start.len() {
                    hash = hash.number(start[i].len() as u64).bytes(start[i]);
                    i += 1;
                }
                hash
            }
            Domain::Enumeration { start, items } => {
                let mut hash = self.byte(3).text(items.name);
                let mut i = 0;
                while i < start.len() {
                    hash = hash.number(start[i] as u64);
                    i += 1;
                }
                let mut i = 0;
                while i < items.items.len() {
                    hash = hash
                        .text(items.items[i].name)
                        .number(items.items[i].value as u64);
                    i += 1;
                }
                hash
            }
        }
    }
}

/// `{xxxxxxxx-xxxx-8xxx-xxxx-xxxxxxxxxxxx}`: version 8 and the RFC 9562 variant.
const fn format(hash: u128) -> [u8; LENGTH] {
    const VERSION: u128 = 0xf << 76;
    const VARIANT: u128 = 0b11 << 62;
    let hash = hash & !VERSION & !VARIANT | 8 << 76 | 0b10 << 62;
    let mut text = *b"{00000000-0000-0000-0000-000000000000}";
    let mut digit = 0;
    let mut i = 0;
    while i < LENGTH {
        if text[i] == b'0' {
            let value = (hash >> (124 - 4 * digit)) as usize & 0xf;
            text[i] = b"0123456789abcdef"[value];
            digit += 1;
        }
        i += 1;
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::scalars;
    use crate::{Causality, Overrides, Reals, Row, Variability, Variable};

    fn k(start: &'static [f64]) -> Variable {
        Variable {
            name: "k",
            description: "gain",
            offset: 0,
            causality: Causality::Parameter,
            variability: Variability::Tunable,
            dimensions: &[],
            size: "",
            domain: Domain::Real {
                start: Reals::Float64(start),
                min: f64::NEG_INFINITY,
                max: f64::INFINITY,
                unit: "1",
            },
            initially_from: &[],
            dynamics: Dynamics::Algebraic,
            depends_on: &[],
            has_input_derivative: false,
            terminal: "",
        }
    }

    fn interface(name: &'static str, variables: &[Variable]) -> Interface {
        let rows: Vec<Row> = variables.iter().copied().map(Row::Variable).collect();
        Interface {
            name,
            description: "amplifier",
            is_sampled: false,
            is_continuous: false,
            default_experiment: (1.0, 0.1),
            tolerance: 0.0,
            scalars: match rows.len() {
                0 => &[],
                _ => Box::leak(Box::new(scalars::<1>(rows.leak()))),
            },
            overrides: Overrides::NONE,
        }
    }

    fn text(interface: &Interface) -> String {
        String::from_utf8(guid(interface).to_vec()).unwrap()
    }

    /// Published test vectors of 128-bit FNV-1a: "" and "a".
    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(Hash::new().0, 0x6c62272e07bb014262b821756295c58d);
        assert_eq!(
            Hash::new().bytes(b"a").0,
            0xd228cb696f1a8caf78912b704e4a8964
        );
    }

    #[test]
    fn the_guid_is_a_version_8_uuid() {
        let guid = text(&interface("Model", &[k(&[1.0])]));
        assert_eq!(guid.len(), LENGTH);
        assert_eq!(&guid[15..16], "8");
        assert!("89ab".contains(&guid[20..21]), "{guid}");
        for (i, c) in guid.char_indices() {
            match i {
                0 => assert_eq!(c, '{'),
                37 => assert_eq!(c, '}'),
                9 | 14 | 19 | 24 => assert_eq!(c, '-'),
                _ => assert!(c.is_ascii_hexdigit()),
            }
        }
    }

    #[test]
    fn the_guid_changes_with_the_interface_only() {
        let model = interface("Model", &[k(&[1.0])]);
        let described = Variable {
            description: "another text",
            ..k(&[1.0])
        };
        assert_eq!(text(&model), text(&interface("Model", &[described])));
        let bounded = Variable {
            domain: Domain::Real {
                start: Reals::Float64(&[1.0]),
                min: 0.0,
                max: f64::INFINITY,
                unit: "1",
            },
            ..k(&[])
        };
        let fixed = Variable {
            variability: Variability::Fixed,
            ..k(&[1.0])
        };
        let (_, overrides) = Overrides::of("Model", "Model=Model;0:r16:4000000000000000").unwrap();
        for other in [
            interface("Other", &[k(&[1.0])]),
            interface("Model", &[k(&[2.0])]),
            interface("Model", &[bounded]),
            interface("Model", &[fixed]),
            interface("Model", &[]),
            Interface {
                is_sampled: true,
                ..model
            },
            Interface { overrides, ..model },
        ] {
            assert_ne!(text(&model), text(&other));
        }
    }
}
