//! FNV-1a, a hash of 128 bits that constant evaluation can compute.

/// The hash of bytes, to detect damage.
pub const fn checksum(bytes: &[u8]) -> u128 {
    Hash::new().bytes(bytes).0
}

/// FNV-1a, 128 bits.
#[derive(Clone, Copy)]
pub struct Hash(pub u128);

impl Hash {
    /// The hash of nothing.
    #[allow(clippy::new_without_default, reason = "a constant function, which a trait cannot have")]
    pub const fn new() -> Self {
        Self(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d)
    }

    /// With more bytes.
    pub const fn bytes(mut self, bytes: &[u8]) -> Self {
        let mut i = 0;
        while i < bytes.len() {
            let mixed = self.0 ^ bytes[i] as u128;
            self = Self(mixed.wrapping_mul(0x0000_0000_0100_0000_0000_0000_0000_013b));
            i += 1;
        }
        self
    }

    pub(crate) const fn number(self, number: u64) -> Self {
        self.bytes(&number.to_le_bytes())
    }

    /// A text, and a byte that UTF-8 does not have: "a", "bc" differs from "ab", "c".
    pub(crate) const fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes()).bytes(&[0xff])
    }

    /// A prefix of a name, unless it is empty.
    pub(crate) const fn prefix(self, prefix: &str) -> Self {
        if prefix.is_empty() { self } else { self.bytes(prefix.as_bytes()).bytes(b".") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Published test vectors of 128-bit FNV-1a: "" and "a".
    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(checksum(b""), 0x6c62272e07bb014262b821756295c58d);
        assert_eq!(checksum(b"a"), 0xd228cb696f1a8caf78912b704e4a8964);
    }
}
