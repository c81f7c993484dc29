//! `exp` against multiple-precision arithmetic, on a million points.

use astro_float_num::{BigFloat, Consts, RoundingMode};
use pendulum_control::exp::exp;

/// Bits of the reference.
const PRECISION: usize = 128;
const ROUNDING: RoundingMode = RoundingMode::ToEven;
/// Number of points of a progression.
const POINTS: u64 = 1 << 13;

/// The generator of pseudorandom numbers of Knuth's MMIX.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        const FACTOR: u64 = 6_364_136_223_846_793_005;
        const INCREMENT: u64 = 1_442_695_040_888_963_407;
        self.0 = self.0.wrapping_mul(FACTOR).wrapping_add(INCREMENT);
        ((u128::from(self.0) * u128::from(limit)) >> 64) as u64
    }
}

fn big(x: f64) -> BigFloat {
    // `from_f64` halves denormal numbers.
    let scale = if x.abs() < 1e-200 { 100 } else { 0 };
    let mut big = BigFloat::from_f64(x * 2f64.powi(scale), PRECISION);
    if let Some(exponent) = big.exponent() {
        big.set_exponent(exponent - scale);
    }
    big
}

/// The spacing of numbers from `x` on.
fn ulp(x: f64) -> f64 {
    f64::from_bits(x.abs().to_bits() + 1) - x.abs()
}

/// |actual - exact| in units of the last place of the actual value.
fn error(actual: f64, exact: &BigFloat) -> f64 {
    let difference = big(actual).sub(exact, PRECISION, ROUNDING);
    let ulps = difference.div(&big(ulp(actual)), PRECISION, ROUNDING);
    let (words, _, _, exponent, _) = ulps.as_raw_parts().unwrap();
    // The words are a fraction, the last one is the most significant.
    *words.last().unwrap() as f64 * 2f64.powi(exponent - 64)
}

/// The largest error over a random arithmetic progression of points from `first`, a power of 2, to twice
/// that. There, the spacing of numbers does not change, so that all points are exact. Their exponentials
/// are a geometric progression.
fn largest_error(first: f64, random: &mut Random, constants: &mut Consts) -> f64 {
    let stride = random.below((1 << 52) / POINTS);
    let start = first.to_bits() + random.below((1 << 52) - stride * POINTS);
    let mut exp_of = |x| big(x).exp(PRECISION, ROUNDING, constants);
    let mut expected = exp_of(f64::from_bits(start));
    let factor = exp_of((stride as f64 * ulp(first)).copysign(first));
    let mut largest = 0.0_f64;
    for k in 0..POINTS {
        let x = f64::from_bits(start + k * stride);
        let error = error(exp(x), &expected);
        assert!(error < 1.0, "exp({x:?}) = {:?}: {error} ulp", exp(x));
        largest = largest.max(error);
        expected = expected.mul(&factor, PRECISION, ROUNDING);
    }
    largest
}

#[test]
fn errors_are_below_one_unit_in_the_last_place() {
    let mut constants = Consts::new().unwrap();
    let mut random = Random(1);
    let mut largest = 0.0_f64;
    // Negative numbers to where the result is 0, and positive ones to where it is almost infinite.
    for (sign, exponents) in [(-1.0, -54..=9), (1.0, -54..=8)] {
        for exponent in exponents {
            let first = sign * 2f64.powi(exponent);
            largest = largest.max(largest_error(first, &mut random, &mut constants));
        }
    }
    // An error of less than half a unit is not possible in general.
    assert!(largest > 0.5, "{largest}");
    println!("the largest error is {largest:.3} ulp");
}

/// The points around those where the result is denormal or infinite, and where n changes.
#[test]
fn errors_at_the_edges_are_below_one_unit_in_the_last_place() {
    let mut constants = Consts::new().unwrap();
    let halves = (-1075..=1023).map(|n| (f64::from(n) + 0.5) * std::f64::consts::LN_2);
    let edges = [-745.133_219_101_941_1, -708.396_418_532_264_1, 709.782_712_893_383_9];
    for edge in halves.chain(edges) {
        for k in -20_i64..=20 {
            let x = f64::from_bits(edge.to_bits().wrapping_add_signed(k));
            let exact = big(x).exp(PRECISION, ROUNDING, &mut constants);
            if exp(x) == f64::INFINITY {
                assert!(x > 709.782_712_893_383_9, "{x:?}");
                continue;
            }
            let error = error(exp(x), &exact);
            assert!(error < 1.0, "exp({x:?}) = {:?}: {error} ulp", exp(x));
        }
    }
}
