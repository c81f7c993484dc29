//! The identity of an interface, computed at compile time.

use crate::{Causality, Domain, Info, Variability, Variable};

/// Length of a GUID as text, including the braces.
pub const LENGTH: usize = 38;

/// The GUID of a model: the 128-bit FNV-1a hash of its name and its variables (names, order,
/// causality, variability, types, starts, bounds, units), formatted as a version 8 UUID. It is the
/// same in every build and changes with the interface.
pub const fn guid<M>(model: &str, variables: &[Variable<M>]) -> [u8; LENGTH] {
    let mut hash = Hash::new().text(model);
    let mut i = 0;
    while i < variables.len() {
        hash = hash.variable(&variables[i].info);
        i += 1;
    }
    format(hash.0)
}

/// The 128-bit FNV-1a hash of bytes, to detect corruption.
pub const fn checksum(bytes: &[u8]) -> u128 {
    Hash::new().bytes(bytes).0
}

/// FNV-1a, 128 bits.
struct Hash(u128);

impl Hash {
    const fn new() -> Self {
        Self(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d)
    }

    const fn byte(self, byte: u8) -> Self {
        Self((self.0 ^ byte as u128).wrapping_mul(0x0000_0000_0100_0000_0000_0000_0000_013b))
    }

    const fn bytes(mut self, bytes: &[u8]) -> Self {
        let mut i = 0;
        while i < bytes.len() {
            self = self.byte(bytes[i]);
            i += 1;
        }
        self
    }

    /// A text and a terminator, so that "a", "bc" differs from "ab", "c".
    const fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes()).byte(0xff)
    }

    const fn number(self, number: u64) -> Self {
        self.bytes(&number.to_le_bytes())
    }

    const fn variable(self, variable: &Info) -> Self {
        let hash = self
            .text(variable.name)
            .byte(match variable.causality {
                Causality::Parameter => 0,
                Causality::Input => 1,
                Causality::Output => 2,
                Causality::CalculatedParameter => 3,
                Causality::Local => 4,
                Causality::Independent => 5,
            })
            .byte(match variable.variability {
                Variability::Fixed => 0,
                Variability::Tunable => 1,
                Variability::Discrete => 2,
                Variability::Continuous => 3,
                Variability::Constant => 4,
            })
            .number(variable.count() as u64);
        match &variable.domain {
            Domain::Real {
                start,
                min,
                max,
                unit,
            } => {
                let mut hash = hash
                    .byte(0)
                    .text(unit.name)
                    .number(min.to_bits())
                    .number(max.to_bits());
                let mut i = 0;
                while i < variable.count() {
                    if let Some(start) = start.of(i) {
                        hash = hash.number(start.to_bits());
                    }
                    i += 1;
                }
                hash
            }
            Domain::Integer { start, range } => hash
                .byte(1)
                .number(*start as u64)
                .number(range.0 as u64)
                .number(range.1 as u64),
            Domain::Boolean { start } => hash.byte(2).byte(*start as u8),
            Domain::Enumeration { start, items } => {
                let mut hash = hash.byte(3).text(items.name).number(*start as u64);
                let mut i = 0;
                while i < items.items.len() {
                    hash = hash.text(items.items[i].0);
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
    use crate::unit;

    struct Model {
        k: f64,
    }

    fn text(model: &str, variables: &[Variable<Model>]) -> String {
        String::from_utf8(guid(model, variables).to_vec()).unwrap()
    }

    fn k(start: f64) -> Variable<Model> {
        Variable::tunable("k", start, |m: &mut Model| &mut m.k).about("gain")
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
        let guid = text("Model", &[k(1.0)]);
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
        let guid = text("Model", &[k(1.0)]);
        assert_eq!(guid, text("Model", &[k(1.0).about("another text")]));
        for other in [
            text("Other", &[k(1.0)]),
            text("Model", &[k(2.0)]),
            text("Model", &[k(1.0).at_least(0.0)]),
            text("Model", &[k(1.0).unit(unit::NEWTON)]),
            text("Model", &[]),
        ] {
            assert_ne!(guid, other);
        }
    }
}
