//! Random numbers that can be computed individually and in any order.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Identifies a random number by the seed of the plan, the rank of the parameter among the random
/// ones, and the draw.
pub struct Draw {
    pub seed: u64,
    pub rank: u64,
    pub draw: u64,
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
    pub fn fraction(&self) -> f64 {
        self.fractions()[0]
    }

    /// Normally distributed with mean 0 and deviation 1, by the Box-Muller transform. It uses the
    /// functions of `libm`, which return the same bits on every machine; those of the standard library,
    /// and hence most crates for distributions, do not.
    pub fn normal(&self) -> f64 {
        let [radius, angle] = self.fractions();
        let radius = (-2.0 * libm::log(1.0 - radius)).sqrt(); // never the logarithm of 0
        radius * libm::cos(std::f64::consts::TAU * angle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(seed: u64, rank: u64, draw: u64) -> Draw {
        Draw { seed, rank, draw }
    }

    fn mean(numbers: impl Iterator<Item = f64>) -> f64 {
        let (sum, count) = numbers.fold((0.0, 0), |(sum, count), x| (sum + x, count + 1));
        sum / f64::from(count)
    }

    /// Twenty thousand draws: the moments are within four standard errors.
    #[test]
    fn numbers_have_the_moments_of_their_distribution() {
        let fractions = || (0..20_000).map(|k| draw(1, 0, k).fraction());
        assert!((mean(fractions()) - 0.5).abs() < 0.0082);
        assert!((mean(fractions().map(|u| u * u)) - 1.0 / 3.0).abs() < 0.0085);
        let normals = || (0..20_000).map(|k| draw(1, 0, k).normal());
        assert!(mean(normals()).abs() < 0.029);
        assert!((mean(normals().map(|z| z * z)) - 1.0).abs() < 0.04);
        assert!((mean(normals().map(|z| z.powi(4))) - 3.0).abs() < 0.28);
        assert!((mean(normals().map(|z| f64::from(z.abs() < 1.96))) - 0.95).abs() < 0.0062);
    }

    #[test]
    fn seed_parameter_and_draw_all_change_the_number() {
        let numbers = [draw(0, 0, 0), draw(1, 0, 0), draw(0, 1, 0), draw(0, 0, 1)];
        let mut bits = numbers
            .map(|draw| draw.fractions().map(f64::to_bits))
            .concat();
        bits.sort_unstable();
        bits.dedup();
        assert_eq!(bits.len(), 8);
    }

    #[test]
    fn parameters_are_not_correlated() {
        let product = |k| (draw(1, 0, k).fraction() - 0.5) * (draw(1, 1, k).fraction() - 0.5);
        assert!(mean((0..20_000).map(product)).abs() < 4.0 / 12.0 / 141.0);
    }
}
