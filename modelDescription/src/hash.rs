//! FNV-1a, a hash of 128 bits that constant evaluation can compute.

/// The factor of a byte.
const PRIME: u128 = 0x0000_0000_0100_0000_0000_0000_0000_013b;
/// The factors of up to eight zero bytes.
const POWERS: [u128; 9] = {
    let (mut powers, mut i) = ([1_u128; 9], 1);
    while i < powers.len() {
        powers[i] = powers[i - 1].wrapping_mul(PRIME);
        i += 1;
    }
    powers
};

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
    pub const fn bytes(self, mut bytes: &[u8]) -> Self {
        let mut hash = self.0;
        // A pattern is no call of a function, which takes the compiler long.
        while let [first, rest @ ..] = bytes {
            hash = (hash ^ *first as u128).wrapping_mul(PRIME);
            bytes = rest;
        }
        Self(hash)
    }

    pub(crate) const fn number(self, number: u64) -> Self {
        self.numbers(number, 1)
    }

    /// The bytes of a number, so many times. A run of zero bytes only multiplies the hash, which is one step: most numbers
    /// are short, and an array may have so many that the compiler would warn.
    pub(crate) const fn numbers(mut self, number: u64, count: usize) -> Self {
        if number == 0 {
            return Self(self.0.wrapping_mul(POWERS[8].wrapping_pow(count as u32)));
        }
        // The factor of the zeros before each other byte, and the byte.
        let (mut bytes, mut length, mut zeros, mut rest, mut left) = ([(0, 0); 8], 0, 8, number, 8);
        while rest != 0 {
            zeros = rest.trailing_zeros() as usize / 8;
            rest >>= 8 * zeros;
            bytes[length] = (POWERS[zeros], (rest & 0xff) as u128);
            (length, rest, left) = (length + 1, rest >> 8, left - zeros - 1);
            zeros = left;
        }
        let mut repeats = 0;
        while repeats < count {
            let mut i = 0;
            while i < length {
                let mixed = self.0.wrapping_mul(bytes[i].0) ^ bytes[i].1;
                self = Self(mixed.wrapping_mul(PRIME));
                i += 1;
            }
            self = Self(self.0.wrapping_mul(POWERS[zeros]));
            repeats += 1;
        }
        self
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

    #[test]
    fn the_hash_of_a_number_is_the_hash_of_its_bytes() {
        for number in [0, 1, 0x100, 0xff00_ff00, 1 << 63, u64::MAX, 2.5_f64.to_bits()] {
            let bytes = Hash::new().bytes(&number.to_le_bytes());
            assert_eq!(Hash::new().number(number).0, bytes.0, "{number:#x}");
            let thrice = Hash::new().number(number).number(number).number(number);
            assert_eq!(Hash::new().numbers(number, 3).0, thrice.0, "{number:#x}");
        }
    }

    /// Published test vectors of 128-bit FNV-1a: "" and "a".
    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(checksum(b""), 0x6c62272e07bb014262b821756295c58d);
        assert_eq!(checksum(b"a"), 0xd228cb696f1a8caf78912b704e4a8964);
    }
}
