//! The radial-basis-function network (12) to (14) and its learning rule (18), (19).

use crate::vector::{self, Weights};

/// A network of `N` Gaussian nodes with one input, the set-point.
///
/// Parameters may be changed between samples; after a change of `centres` or `widths`, call
/// [`Rbf::reset`].
///
/// ```
/// let mut rbf = pendulum_control::Rbf::<1>::default();
/// rbf.eta = 0.5;
/// rbf.activate(0.0);
/// rbf.learn(2.0);
/// assert_eq!(rbf.output(), 1.0); // halfway to 2
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Rbf<const N: usize> {
    /// Weight w_j of the node (N).
    #[cfg_attr(feature = "fmi", output(name = "w", unit = "N", initially_from("w0")))]
    pub weights: [f64; N],
    /// Activation h_j of the node.
    #[cfg_attr(feature = "fmi", output(name = "h", unit = "1"))]
    pub activations: [f64; N],
    /// Learning rate eta.
    #[cfg_attr(
        feature = "fmi",
        parameter(tunable, start = 0.3, min = 0, max = 10, unit = "1")
    )]
    pub eta: f64,
    /// Momentum factor alpha.
    #[cfg_attr(
        feature = "fmi",
        parameter(tunable, start = 0.05, min = 0, max = 1, unit = "1")
    )]
    pub alpha: f64,
    /// Centre c_j of the node (rad).
    #[cfg_attr(
        feature = "fmi",
        parameter(name = "c", start = centres(), min = -1e9, max = 1e9, unit = "rad")
    )]
    pub centres: [f64; N],
    /// Width b_j of the node (rad), positive.
    #[cfg_attr(
        feature = "fmi",
        parameter(name = "b", start = 0.5, min = 1e-6, max = 1e9, unit = "rad")
    )]
    pub widths: [f64; N],
    /// Initial weight of the node (N).
    #[cfg_attr(feature = "fmi", parameter(name = "w0", min = -1e9, max = 1e9, unit = "N"))]
    pub initial_weights: [f64; N],
    weights_before: [f64; N],
    /// The input of `activations`; NaN if there is none yet.
    input: f64,
    /// -1/(2 b_j^2) of the nodes (1/rad^2), if there is an input.
    factors: [f64; N],
}

/// Centres as in section 4: whole numbers on both sides of zero, -2, -1, 1, 2 for 4 nodes.
pub const fn centres<const N: usize>() -> [f64; N] {
    let mut centres = [0.0; N];
    let mut j = 0;
    while j < N {
        let from_middle = j as f64 - (N / 2) as f64;
        let skips_zero = N.is_multiple_of(2) && j >= N / 2;
        centres[j] = if skips_zero {
            from_middle + 1.0
        } else {
            from_middle
        };
        j += 1;
    }
    centres
}

impl<const N: usize> Default for Rbf<N> {
    fn default() -> Self {
        Self {
            centres: [0.0; N],
            widths: [1.0; N],
            eta: 0.0,
            alpha: 0.0,
            initial_weights: [0.0; N],
            weights: [0.0; N],
            activations: [0.0; N],
            weights_before: [0.0; N],
            input: f64::NAN,
            factors: [0.0; N],
        }
    }
}

impl<const N: usize> Rbf<N> {
    /// Restarts learning from the initial weights, without momentum and activations.
    pub fn reset(&mut self) {
        self.weights = self.initial_weights;
        self.weights_before = self.initial_weights;
        self.activations = [0.0; N];
        self.input = f64::NAN;
    }

    /// Activates the nodes: h_j = exp(-(r - c_j)^2 / (2 b_j^2)), equation (12).
    #[inline(always)]
    pub fn activate(&mut self, r: f64) {
        // The set-point rarely changes, and the exponentials dominate the cost of a sample.
        if r != self.input {
            self.compute_activations(r);
        }
    }

    #[inline(always)]
    fn compute_activations(&mut self, r: f64) {
        if self.input.is_nan() {
            self.factors = self.widths.map(|b| -1.0 / (2.0 * b * b));
        }
        vector::gaussians(&mut self.activations, r, &self.centres, &self.factors);
        self.input = r;
    }

    /// The output u_n = sum w_j h_j, equation (14).
    #[inline(always)]
    pub fn output(&self) -> f64 {
        vector::dot(&self.weights, &self.activations)
    }

    /// One step of gradient descent on (u_n - target)^2 / 2 with momentum, (18), (19):
    /// w(k) = w(k-1) - eta (u_n - target) h + alpha (w(k-1) - w(k-2)).
    pub fn learn(&mut self, target: f64) {
        self.descend(self.output() - target);
    }

    /// As [`learn`](Self::learn), with `gradient` = u_n - target already known.
    #[inline(always)]
    pub(crate) fn descend(&mut self, gradient: f64) {
        let weights = Weights {
            now: &mut self.weights,
            before: &mut self.weights_before,
        };
        vector::learn(weights, &self.activations, gradient, self.eta, self.alpha);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_are_whole_numbers_on_both_sides_of_zero() {
        assert_eq!(centres(), [-2.0, -1.0, 1.0, 2.0]);
        assert_eq!(centres(), [-1.0, 0.0, 1.0]);
    }

    /// The network of section 4: (42), (43), whose centres and widths are swapped in print.
    fn network() -> Rbf<4> {
        Rbf {
            centres: [-2.0, -1.0, 1.0, 2.0],
            widths: [0.5; 4],
            eta: 0.3,
            alpha: 0.05,
            ..Default::default()
        }
    }

    fn norm_squared(h: &[f64; 4]) -> f64 {
        h.iter().map(|h| h * h).sum()
    }

    #[test]
    fn activations_are_gaussians_of_the_distance_to_the_centre() {
        let mut rbf = network();
        rbf.activate(1.0);
        // Distances in widths: 6, 4, 0, 2.
        let expected = [-18.0f64, -8.0, 0.0, -2.0].map(libm::exp);
        for (h, expected) in rbf.activations.iter().zip(expected) {
            assert!((h - expected).abs() < 1e-16);
        }
    }

    #[test]
    fn reset_discards_the_activations_of_old_centres() {
        let mut rbf = network();
        rbf.activate(1.0);
        rbf.centres[3] = 1.0;
        rbf.reset();
        rbf.activate(1.0);
        assert_eq!(rbf.activations[3], 1.0);
    }

    /// Section 3.2 bounds the learning rate for a fixed target by eta |h|^2 < 2, with momentum by
    /// 2 (1 + alpha): learning converges just below and diverges just above.
    #[test]
    fn learning_a_fixed_target_converges_exactly_within_the_bound() {
        for alpha in [0.0, 0.05, 0.5] {
            let mut rbf = network();
            rbf.activate(1.0);
            let limit = 2.0 * (1.0 + alpha) / norm_squared(&rbf.activations);
            let mut misses = [0.999, 1.001].map(|factor| {
                let mut rbf = Rbf {
                    eta: factor * limit,
                    alpha,
                    ..rbf
                };
                for _ in 0..20_000 {
                    rbf.learn(1.0);
                }
                (rbf.output() - 1.0).abs()
            });
            assert!(misses[0] < 1e-3, "below the bound: {misses:?}");
            misses[1] = if misses[1].is_finite() {
                misses[1]
            } else {
                f64::MAX
            };
            assert!(misses[1] > 1e3, "above the bound: {misses:?}");
        }
    }

    #[test]
    fn the_squared_norm_of_the_activations_at_one_matches_its_closed_form() {
        let mut rbf = network();
        rbf.activate(1.0);
        let expected = 1.0 + libm::exp(-4.0) + libm::exp(-16.0) + libm::exp(-36.0);
        assert!((norm_squared(&rbf.activations) - expected).abs() < 1e-15);
    }
}
