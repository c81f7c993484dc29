//! The embedded Runge-Kutta pair 5(4) of Dormand and Prince (J. Comput. Appl. Math. 6, 1980) with the dense
//! output of Hairer, Nørsett and Wanner (Solving Ordinary Differential Equations I, section II.6).
//!
//! It has tables and the control of the step size. The caller provides the memory of the stages: on the
//! stack for a few states, or allocated once.

/// Number of stages. The last one is at the end of a step, so that it is the first one of the next.
pub const STAGES: usize = 7;

/// Nodes: the time of each stage as a fraction of the step.
pub const NODES: [f64; STAGES] = [0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0];

/// The weights of the slopes before each stage. The last ones give the fifth-order result.
pub const WEIGHTS: [&[f64]; STAGES] = [
    &[],
    &[1.0 / 5.0],
    &[3.0 / 40.0, 9.0 / 40.0],
    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
    &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0],
    &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
    &[35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
];

/// The weights of the error: of fifth order minus fourth order.
pub const ERROR: [f64; STAGES] = [
    71.0 / 57600.0,
    0.0,
    -71.0 / 16695.0,
    71.0 / 1920.0,
    -17253.0 / 339200.0,
    22.0 / 525.0,
    -1.0 / 40.0,
];

/// The weights of the highest term of the dense output.
const DENSE: [f64; STAGES] = [
    -12715105075.0 / 11282082432.0,
    0.0,
    87487479700.0 / 32700410799.0,
    -10690763975.0 / 1880347072.0,
    701980252875.0 / 199316789632.0,
    -1453857185.0 / 822651844.0,
    69997945.0 / 29380423.0,
];

/// Maximum growth of the size from one step to the next.
const MAX_GROWTH: f64 = 5.0;
/// Maximum shrinkage, also after a point at which the equations have no values.
pub const MAX_SHRINKAGE: f64 = 0.2;

/// The factor for the size of the next step after one of the given error relative to the tolerance.
pub fn factor(error: f64) -> f64 {
    match error.is_finite() {
        true => (0.9 * libm::pow(error.max(1e-10), -0.2)).clamp(MAX_SHRINKAGE, MAX_GROWTH),
        false => MAX_SHRINKAGE,
    }
}

/// The sum of the slopes of a state with weights.
#[inline(always)]
pub fn weighted(weights: &[f64], slopes: &[impl AsRef<[f64]>; STAGES], state: usize) -> f64 {
    let terms = weights.iter().zip(slopes);
    terms.map(|(weight, k)| weight * k.as_ref()[state]).sum()
}

/// A state at a `fraction` of a step of size `h`, in which it changes from `start` to `end`.
#[inline]
pub fn interpolate(
    fraction: f64,
    h: f64,
    (start, end): (f64, f64),
    slopes: &[impl AsRef<[f64]>; STAGES],
    state: usize,
) -> f64 {
    let change = end - start;
    let first = h * slopes[0].as_ref()[state] - change;
    let last = change - h * slopes[STAGES - 1].as_ref()[state] - first;
    let fifth = h * weighted(&DENSE, slopes, state);
    let rest = 1.0 - fraction;
    let inner = first + fraction * (last + rest * fifth);
    start + fraction * (change + rest * inner)
}
