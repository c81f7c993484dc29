//! The exponential function, in a form that compilers vectorize.
//!
//! With x = n ln 2 + r, n a whole number and |r| <= ln(2)/2, exp(x) = 2^n exp(r), and a polynomial
//! gives exp(r) = 1 + r + r^2 q(r). There are no branches, no tables and none of the rarely vectorized
//! conversions between numbers of different types. Every operation is rounded on its own, since Rust
//! never fuses a multiplication and an addition. Hence the bits depend neither on the platform nor on the
//! width of its vectors.

use core::f64::consts::LOG2_E;

/// exp rounds to 0 below this.
const LOWEST: f64 = -746.0;
/// exp rounds to infinity above this.
const HIGHEST: f64 = 710.0;

/// ln 2 as a sum. The first part ends in 11 zero bits, so that its product with n is exact.
const LN_2: (f64, f64) =
    (f64::from_bits(0x3fe6_2e42_fefa_3800), f64::from_bits(0x3d2e_f357_93c7_6730));

/// Coefficients of q, with which the relative error of exp(r) is below 2^-57 before rounding.
const Q: [f64; 10] = [
    0.5,
    0.166_666_666_666_664_35,
    0.041_666_666_666_604_19,
    0.008_333_333_333_498_685,
    0.001_388_888_892_669_72,
    0.000_198_412_694_691_109_16,
    2.480_150_880_728_692e-5,
    2.755_763_827_552_906_4e-6,
    2.762_513_767_989_27e-7,
    2.497_921_296_432_225e-8,
];

/// Twice the bias of the exponent of a number: one for each of two powers.
const BIASES: f64 = 2046.0;
/// Where the spacing of numbers is 1, so that a sum with a small number is rounded to a whole one, whose
/// lowest bits are n + `BIASES`.
const ROUND: f64 = 1.5 / f64::EPSILON + BIASES;

/// exp(x) with an error below 1 ulp (unit in the last place), also where the result is denormal, and
/// infinity where it overflows. NaN stays NaN.
///
/// ```
/// use pendulum_control::exp::exp;
///
/// assert_eq!(exp(0.0), 1.0);
/// assert_eq!(exp(-1000.0), 0.0);
/// ```
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    // Not `clamp`, since compilers do not vectorize it.
    exp_to_highest(if x > HIGHEST { HIGHEST } else { x })
}

/// [`exp`] of a number that is at most `HIGHEST`.
#[inline(always)]
pub(crate) fn exp_to_highest(x: f64) -> f64 {
    let x = if x < LOWEST { LOWEST } else { x };
    let rounded = x * LOG2_E + ROUND;
    let n = rounded - ROUND;
    let (high, low) = (x - n * LN_2.0, n * LN_2.1);
    let r = high - low;
    // 2^n is a product of two powers, since it may be less than the smallest normal number.
    let biased = rounded.to_bits();
    let half = biased >> 1;
    let power = f64::from_bits(half << 52);
    let other_power = f64::from_bits((biased - half) << 52);
    // Estrin's scheme, whose operations wait for each other less than in Horner's scheme.
    let r2 = r * r;
    let r4 = r2 * r2;
    let q0 = (Q[0] + r * Q[1]) + r2 * (Q[2] + r * Q[3]);
    let q4 = (Q[4] + r * Q[5]) + r2 * (Q[6] + r * Q[7]);
    let q8 = Q[8] + r * Q[9];
    let q = (q0 + (r4 * r4) * q8) + r4 * q4;
    // 1 + high - low + r^2 q. The sum 1 + high and its rounding error are known before q is.
    let sum = 1.0 + high;
    let rest = (high - (sum - 1.0)) - low;
    (power * sum + (power * rest + (power * r2) * q)) * other_power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_the_range_are_rounded_correctly() {
        for (x, expected) in [
            (0.0, 1.0),
            (-0.0, 1.0),
            (f64::MIN_POSITIVE, 1.0),
            (-f64::EPSILON / 4.0, 1.0),
            (-f64::EPSILON, 1.0 - f64::EPSILON),
            (709.782_712_893_384, 1.797_693_134_862_273_2e308),
            (709.782_712_893_384_1, f64::INFINITY),
            (1e300, f64::INFINITY),
            (f64::INFINITY, f64::INFINITY),
            (-745.133_219_101_941_1, f64::from_bits(1)),
            (-745.133_219_101_941_2, 0.0),
            (-1e300, 0.0),
            (f64::NEG_INFINITY, 0.0),
        ] {
            assert_eq!(exp(x), expected, "exp({x:e})");
        }
        assert!(exp(f64::NAN).is_nan());
        assert!(exp(-f64::NAN).is_nan());
    }
}
