//! Loops over the nodes of a network. A loop over many nodes uses the longest vectors that the processor
//! has, which is found out at run time. Their length does not change the bits.

#[cfg(not(target_arch = "wasm32"))]
use core::hint::black_box;
use core::ops::Range;

use multiversion::multiversion;

use crate::exp::exp_to_highest;

/// The paper's number of nodes, for which the compiler unrolls loops.
pub(crate) const PAPER: usize = 4;

/// Up to this number of nodes, a loop without a call is faster.
const FEW: usize = 16;

/// The number of partial sums of a scalar product.
const LANES: usize = 8;

/// Calls a loop for the paper's number of nodes, of which the compiler knows that it is at most [`PAPER`] and a
/// multiple of it. It makes single operations of a loop with few iterations if it knows their number, and vectors else.
#[cfg(not(target_arch = "wasm32"))]
#[inline(always)]
fn in_one_vector(mut each: impl FnMut(Range<usize>)) {
    let n = black_box(1) * PAPER;
    if n <= PAPER {
        each(0..n);
    }
}

/// Calls a loop for each of the paper's number of nodes. A component is optimized for size, so that its loops would stay,
/// and hosts check in each iteration whether the time is over.
#[cfg(target_arch = "wasm32")]
#[inline(always)]
fn in_one_vector(mut each: impl FnMut(Range<usize>)) {
    const { assert!(PAPER == 4) };
    each(0..1);
    each(1..2);
    each(2..3);
    each(3..4);
}

/// Sets `values[j]` to exp(factor_j (x - centre_j)^2), where all factors are negative.
#[inline(always)]
pub(crate) fn gaussians(values: &mut [f64], x: f64, centres: &[f64], factors: &[f64]) {
    if let (Ok(values), Ok(centres), Ok(factors)) = (
        <&mut [f64; PAPER]>::try_from(&mut *values),
        <&[f64; PAPER]>::try_from(centres),
        <&[f64; PAPER]>::try_from(factors),
    ) {
        in_one_vector(
            // Not a call for each node where a library is optimized for size.
            #[inline(always)]
            |nodes| {
                let values = &mut values[nodes.clone()];
                each_gaussian(values, x, &centres[nodes.clone()], &factors[nodes]);
            },
        );
    } else if values.len() > FEW {
        many_gaussians(values, x, centres, factors);
    } else {
        few_gaussians(values, x, centres, factors);
    }
}

#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn many_gaussians(values: &mut [f64], x: f64, centres: &[f64], factors: &[f64]) {
    each_gaussian(values, x, centres, factors);
}

#[multiversion(targets("x86_64+avx2"))]
fn few_gaussians(values: &mut [f64], x: f64, centres: &[f64], factors: &[f64]) {
    each_gaussian(values, x, centres, factors);
}

#[inline(always)]
fn each_gaussian(values: &mut [f64], x: f64, centres: &[f64], factors: &[f64]) {
    for ((value, centre), factor) in values.iter_mut().zip(centres).zip(factors) {
        let distance = x - centre;
        *value = exp_to_highest(distance * distance * factor);
    }
}

/// The scalar product, summed in an order that is the same for all vectors.
#[inline(always)]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    if let (Ok(a), Ok(b)) = (<&[f64; PAPER]>::try_from(a), <&[f64; PAPER]>::try_from(b)) {
        // As below, where the other sums are neutral.
        let product = |j: usize| a[j] * b[j];
        (product(0) + product(2)) + (product(1) + product(3))
    } else if a.len() > FEW {
        dot_many(a, b)
    } else {
        dot_few(a, b)
    }
}

#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn dot_many(a: &[f64], b: &[f64]) -> f64 {
    dot_few(a, b)
}

#[inline(always)]
fn dot_few(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [-0.0; LANES]; // the neutral element of addition
    let (blocks, rest) = a.as_chunks::<LANES>();
    let (blocks_of_b, rest_of_b) = b.as_chunks::<LANES>();
    for (a, b) in blocks.iter().zip(blocks_of_b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    for ((sum, a), b) in sums.iter_mut().zip(rest).zip(rest_of_b) {
        *sum += a * b;
    }
    let [s0, s1, s2, s3, s4, s5, s6, s7] = sums;
    ((s0 + s4) + (s2 + s6)) + ((s1 + s5) + (s3 + s7))
}

/// Takes `gradient rate direction` from the weights, and adds `momentum` times their change since `before`,
/// the weights of one sample before. The gradient, which is known last, is used last.
#[inline(always)]
pub(crate) fn learn(
    weights: &mut [f64],
    before: &mut [f64],
    direction: &[f64],
    gradient: f64,
    rate: f64,
    momentum: f64,
) {
    if let (Ok(weights), Ok(before), Ok(direction)) = (
        <&mut [f64; PAPER]>::try_from(&mut *weights),
        <&mut [f64; PAPER]>::try_from(&mut *before),
        <&[f64; PAPER]>::try_from(direction),
    ) {
        in_one_vector(|nodes| {
            let (weights, before) = (&mut weights[nodes.clone()], &mut before[nodes.clone()]);
            learn_few(weights, before, &direction[nodes], gradient, rate, momentum);
        });
    } else if weights.len() > FEW {
        learn_many(weights, before, direction, gradient, rate, momentum);
    } else {
        learn_few(weights, before, direction, gradient, rate, momentum);
    }
}

#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn learn_many(
    weights: &mut [f64],
    before: &mut [f64],
    direction: &[f64],
    gradient: f64,
    rate: f64,
    momentum: f64,
) {
    learn_few(weights, before, direction, gradient, rate, momentum);
}

#[inline(always)]
fn learn_few(
    weights: &mut [f64],
    before: &mut [f64],
    direction: &[f64],
    gradient: f64,
    rate: f64,
    momentum: f64,
) {
    for ((weight, before), direction) in weights.iter_mut().zip(before).zip(direction) {
        let now = *weight;
        *weight = (now + momentum * (now - *before)) - gradient * (rate * direction);
        *before = now;
    }
}

#[cfg(test)]
mod tests {
    use core::array::from_fn;

    use super::*;
    use crate::exp::exp;

    /// Numbers between -1 and 1 without a pattern.
    fn numbers<const N: usize>(seed: f64) -> [f64; N] {
        from_fn(|j| libm::sin(1e3 * libm::sin(seed + j as f64)))
    }

    /// Compares with loops over single numbers, whose bits cannot depend on vectors.
    fn check<const N: usize>() {
        let [a, b, c] = [1.0, 2.0, 3.0].map(numbers::<N>);
        let factors = b.map(|b| -1e3 * b * b);

        let mut values = [0.0; N];
        gaussians(&mut values, 0.5, &a, &factors);
        let expected = from_fn(|j| exp((0.5 - a[j]) * (0.5 - a[j]) * factors[j]));
        assert_eq!(values, expected);

        let (mut now, mut before) = (a, b);
        learn(&mut now, &mut before, &c, 0.3, 0.1, 0.7);
        let expected = from_fn(|j| (a[j] + 0.7 * (a[j] - b[j])) - 0.3 * (0.1 * c[j]));
        assert_eq!(now, expected);
        assert_eq!(before, a);

        let mut sums = [-0.0; LANES];
        for j in 0..N {
            sums[j % LANES] += a[j] * b[j];
        }
        let [s0, s1, s2, s3, s4, s5, s6, s7] = sums;
        let expected = ((s0 + s4) + (s2 + s6)) + ((s1 + s5) + (s3 + s7));
        assert_eq!(dot(&a, &b).to_bits(), expected.to_bits());
    }

    #[test]
    fn loops_have_the_bits_of_single_operations() {
        check::<0>();
        check::<1>();
        check::<4>();
        check::<7>();
        check::<16>();
        check::<17>();
        check::<64>();
        check::<103>();
    }
}
