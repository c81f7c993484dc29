//! Random numbers with the same bits on every machine.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Identifies a random number by a seed, the rank of what it is for, and the draw. It can be computed without
/// the numbers before it.
pub(crate) struct Draw {
    pub(crate) seed: u64,
    pub(crate) rank: u64,
    pub(crate) draw: u64,
}

/// Number of 32-bit words that a draw takes from the cipher's stream, for two 64-bit numbers.
const WORDS: u128 = 4;

impl Draw {
    /// Two independent numbers in [0, 1) with 53 random bits.
    ///
    /// They come from the stream cipher ChaCha8: the seed is the key, the rank the stream, and the
    /// draw the position in the stream.
    fn fractions(&self) -> [f64; 2] {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&self.seed.to_le_bytes());
        let mut cipher = ChaCha8Rng::from_seed(key);
        cipher.set_stream(self.rank);
        cipher.set_word_pos(WORDS * u128::from(self.draw));
        [(); 2].map(|()| (cipher.next_u64() >> 11) as f64 * 2f64.powi(-53))
    }

    /// Uniformly distributed in [0, 1).
    pub(crate) fn fraction(&self) -> f64 {
        self.fractions()[0]
    }

    /// Normally distributed with mean 0 and deviation 1, by the Box-Muller transform. It uses the
    /// functions of `libm`, which return the same bits on every machine; the functions of the standard library,
    /// and hence most crates for distributions, do not.
    pub(crate) fn normal(&self) -> f64 {
        let [radius, angle] = self.fractions();
        let radius = (-2.0 * libm::log(1.0 - radius)).sqrt(); // never the logarithm of 0
        radius * libm::cos(std::f64::consts::TAU * angle)
    }
}
