//! A sensor that delays the angle by whole samples and adds white noise:
//!
//! ```sh
//! cargo fmu export --package sensor --out target/examples
//! ```
//!
//! It is a sampled model whose internal state, a delay line and the number of samples, is restored
//! with the state of an FMU. Equal seeds give the same bits on every machine.
#![forbid(unsafe_code)]

use std::f64::consts::TAU;

use fmu_export::prelude::*;

fmu_export::export!(Sensor);

/// Sampled sensor of an angle, with delay and noise
#[derive(Model)]
#[model(sample_time = self.ts)]
pub struct Sensor {
    /// Angle
    #[input(unit = "rad")]
    theta: f64,
    /// Measured angle; 0 until the delay has passed, apart from noise
    #[output(unit = "rad")]
    y: f64,
    /// Delay in samples
    #[parameter(min = 0, max = 32)]
    delay: i32,
    /// Standard deviation of the noise, which is white and normally distributed
    #[parameter(min = 0, max = 1e9, unit = "rad")]
    noise: f64,
    /// Seed of the noise
    #[parameter(start = 1)]
    seed: i32,
    /// Sample time
    #[parameter(start = 0.001, min = 1e-6, unit = "s")]
    ts: f64,
    /// The last angles; sample k is in place k modulo the length.
    line: [f64; 33],
    /// Number of samples taken.
    samples: u64,
}

impl Simulate for Sensor {
    fn step(&mut self, _time: f64, _ts: f64) -> Result<(), ModelError> {
        let length = self.line.len();
        let newest = (self.samples % length as u64) as usize;
        self.line[newest] = self.theta;
        // The bounds of `delay` keep it below the length.
        let delayed = self.line[(newest + length - self.delay as usize) % length];
        self.y = delayed + self.noise * normal(self.seed, self.samples);
        self.samples += 1;
        Ok(())
    }
}

/// Number `index` of the normal distribution with mean 0 and deviation 1, by Box and Muller.
///
/// The logarithm and the cosine of `libm` are the same on every machine.
fn normal(seed: i32, index: u64) -> f64 {
    let key = mixed(u64::from(seed.cast_unsigned()));
    let [a, b] = [2 * index, 2 * index + 1].map(|n| uniform(key.wrapping_add(n)));
    (-2.0 * libm::log(a)).sqrt() * libm::cos(TAU * b)
}

/// Uniform random number above 0, at most 1.
fn uniform(key: u64) -> f64 {
    ((mixed(key) >> 11) + 1) as f64 / (1_u64 << 53) as f64
}

/// The hash of SplitMix64.
fn mixed(key: u64) -> u64 {
    let mut x = key.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use fmu_export::testing::Driver;

    use super::*;

    /// The measured angles for the angles 1, 2, ... rad.
    fn measured(sensor: Sensor, samples: u32) -> Vec<f64> {
        let mut sensor = Driver::of(sensor);
        let sample = |k| {
            sensor.theta = f64::from(k);
            sensor.step(0.001).unwrap();
            sensor.y
        };
        (1..=samples).map(sample).collect()
    }

    fn noise(seed: i32) -> Vec<f64> {
        let sensor = Sensor { seed, noise: 0.1, ..Sensor::new() };
        let angles = (1..).map(f64::from);
        let noisy = measured(sensor, 10_000).into_iter().zip(angles);
        noisy.map(|(y, theta)| y - theta).collect()
    }

    /// The mean of the products of a sample and the one that is `lag` later.
    fn correlation(values: &[f64], lag: usize) -> f64 {
        let products = values.iter().zip(&values[lag..]).map(|(a, b)| a * b);
        products.sum::<f64>() / values.len() as f64
    }

    #[test]
    fn without_delay_and_noise_it_shows_the_angle() {
        assert_eq!(measured(Sensor::new(), 3), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn it_delays_by_whole_samples() {
        for delay in [1, 2, 32] {
            let sensor = Sensor { delay, ..Sensor::new() };
            let expected = (1..=100).map(|k| f64::from((k - delay).max(0)));
            assert_eq!(measured(sensor, 100), expected.collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_noise_is_white_with_the_given_deviation() {
        let noise = noise(1);
        let mean = noise.iter().sum::<f64>() / noise.len() as f64;
        assert!(mean.abs() < 0.004, "{mean}");
        assert!((correlation(&noise, 0).sqrt() / 0.1 - 1.0).abs() < 0.03);
        for lag in 1..10 {
            assert!(correlation(&noise, lag).abs() < 0.0004, "{lag}");
        }
        let outside = noise.iter().filter(|value| value.abs() > 0.2).count();
        assert!((400..500).contains(&outside), "{outside}, normally 455");
    }

    #[test]
    fn seeds_differ() {
        assert_eq!(noise(-5), noise(-5));
        let (first, second) = (noise(1), noise(2));
        let products = first.iter().zip(&second).map(|(a, b)| a * b);
        assert!((products.sum::<f64>() / 10_000.0).abs() < 0.0004);
    }
}
