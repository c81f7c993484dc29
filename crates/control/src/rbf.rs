//! The radial-basis-function network (12) to (14) and its learning rule (18), (19).

use crate::vector;

/// A network of up to `N` Gaussian nodes with one input, the set-point. Of each array, the first `nodes`
/// elements take part.
///
/// Parameters may be changed between samples; after a change of `centres` or `widths`, call
/// [`Rbf::reset`], and after one of `nodes`, [`Rbf::resize`].
///
/// ```
/// let mut rbf = pendulum_control::Rbf::<1>::default();
/// rbf.eta = 0.5;
/// rbf.activate(0.0);
/// rbf.learn(2.0);
/// assert_eq!(rbf.output(), 1.0); // halfway to 2
/// ```
// Aligned like a vector: one that crosses a line of the cache is slow to read just after it was written.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
#[repr(align(32))]
pub struct Rbf<const N: usize> {
    /// Number of nodes in use, 1 to `N` (the default); a greater one counts as `N`.
    #[cfg_attr(
        feature = "fmi",
        structural_parameter(
            description = "Number of nodes of the network",
            tunable,
            start = 4,
            min = 1,
            max = 16
        )
    )]
    pub nodes: u64,
    /// Weight w_j of the node (N).
    #[cfg_attr(feature = "fmi", output(name = "w", unit = "N", size = nodes, initially_from("w0")))]
    pub weights: [f64; N],
    /// Activation h_j of the node.
    #[cfg_attr(feature = "fmi", output(name = "h", unit = "1", size = nodes, initially_from()))]
    pub activations: [f64; N],
    /// Learning rate eta.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 0.3, min = 0, max = 10, unit = "1"))]
    pub eta: f64,
    /// Momentum factor alpha.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 0.05, min = 0, max = 1, unit = "1"))]
    pub alpha: f64,
    /// Centre c_j of the node (rad).
    #[cfg_attr(
        feature = "fmi",
        parameter(name = "c", start = centres(), min = -1e9, max = 1e9, unit = "rad", size = nodes)
    )]
    pub centres: [f64; N],
    /// Width b_j of the node (rad), positive.
    #[cfg_attr(
        feature = "fmi",
        parameter(name = "b", start = 0.5, min = 1e-6, max = 1e9, unit = "rad", size = nodes)
    )]
    pub widths: [f64; N],
    /// Initial weight of the node (N).
    #[cfg_attr(
        feature = "fmi",
        parameter(name = "w0", min = -1e9, max = 1e9, unit = "N", size = nodes)
    )]
    pub initial_weights: [f64; N],
    weights_before: [f64; N],
    /// The number of nodes at the last reset or change of size.
    nodes_before: u64,
    /// The input of `activations`; NaN if there is none yet.
    input: f64,
    /// -1/(2 b_j^2) of the nodes (1/rad^2).
    factors: [f64; N],
}

/// Centres as in section 4, -2, -1, 1, 2; further ones continue outwards on both sides: 3, -3, 4, -4 and so
/// on, so that networks of any even number of nodes from 4 on are symmetric.
pub const fn centres<const N: usize>() -> [f64; N] {
    const PAPER: [f64; 4] = [-2.0, -1.0, 1.0, 2.0];
    let mut centres = [0.0; N];
    let mut j = 0;
    while j < N {
        let distance = (j / 2 + 1) as f64;
        centres[j] = if j < PAPER.len() {
            PAPER[j]
        } else if j.is_multiple_of(2) {
            distance
        } else {
            -distance
        };
        j += 1;
    }
    centres
}

impl<const N: usize> Default for Rbf<N> {
    fn default() -> Self {
        Self {
            nodes: N as u64,
            centres: [0.0; N],
            widths: [1.0; N],
            eta: 0.0,
            alpha: 0.0,
            initial_weights: [0.0; N],
            weights: [0.0; N],
            activations: [0.0; N],
            weights_before: [0.0; N],
            nodes_before: N as u64,
            input: f64::NAN,
            factors: [-0.5; N],
        }
    }
}

impl<const N: usize> Rbf<N> {
    /// Restarts learning from the initial weights, without momentum and activations.
    pub fn reset(&mut self) {
        self.nodes_before = 0;
        self.resize();
    }

    /// Adapts to a change of `nodes`: nodes that join start with their initial weights and without
    /// momentum, the others keep theirs. The next sample computes all activations.
    pub fn resize(&mut self) {
        let kept = self.nodes_before.min(self.nodes).min(N as u64) as usize;
        self.weights[kept..].copy_from_slice(&self.initial_weights[kept..]);
        self.weights_before[kept..].copy_from_slice(&self.initial_weights[kept..]);
        self.activations[kept..].fill(0.0);
        self.nodes_before = self.nodes;
        self.factors = self.widths.map(|b| -1.0 / (2.0 * b * b));
        self.input = f64::NAN;
    }

    /// Number of nodes in use, at most `N`.
    #[inline(always)]
    pub(crate) fn len(&self) -> usize {
        self.nodes.min(N as u64) as usize
    }

    /// Activates the nodes: h_j = exp(-(r - c_j)^2 / (2 b_j^2)), equation (12).
    #[inline(always)]
    pub fn activate(&mut self, r: f64) {
        self.activate_first(self.len(), r);
    }

    /// As [`activate`](Self::activate) for `n` nodes, the number in use.
    #[inline(always)]
    pub(crate) fn activate_first(&mut self, n: usize, r: f64) {
        // The set-point rarely changes, and the exponentials dominate the cost of a sample.
        if r != self.input {
            let (centres, factors) = (&self.centres[..n], &self.factors[..n]);
            vector::gaussians(&mut self.activations[..n], r, centres, factors);
            self.input = r;
        }
    }

    /// The output u_n = sum w_j h_j, equation (14).
    #[inline(always)]
    pub fn output(&self) -> f64 {
        self.output_of_first(self.len())
    }

    /// As [`output`](Self::output) of `n` nodes, the number in use.
    #[inline(always)]
    pub(crate) fn output_of_first(&self, n: usize) -> f64 {
        vector::dot(&self.weights[..n], &self.activations[..n])
    }

    /// One step of gradient descent on (u_n - target)^2 / 2 with momentum, (18), (19):
    /// w(k) = w(k-1) - eta (u_n - target) h + alpha (w(k-1) - w(k-2)).
    pub fn learn(&mut self, target: f64) {
        self.descend(self.len(), self.output() - target);
    }

    /// As [`learn`](Self::learn) of `n` nodes, the number in use, with `gradient` = u_n - target already
    /// known.
    #[inline(always)]
    pub(crate) fn descend(&mut self, n: usize, gradient: f64) {
        vector::learn(
            &mut self.weights[..n],
            &mut self.weights_before[..n],
            &self.activations[..n],
            gradient,
            self.eta,
            self.alpha,
        );
    }
}

#[cfg(test)]
mod tests {
    use core::array::from_fn;

    use super::*;

    #[test]
    fn centres_are_those_of_the_paper_and_continue_outwards() {
        assert_eq!(centres(), [-2.0, -1.0, 1.0, 2.0]);
        assert_eq!(centres(), [-2.0, -1.0, 1.0, 2.0, 3.0, -3.0, 4.0, -4.0, 5.0]);
    }

    /// The network of section 4: (42), (43), whose centres and widths are swapped in print.
    fn network() -> Rbf<4> {
        crate::closed_loop::network([0.0; 4])
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
            let norm_squared: f64 = rbf.activations.iter().map(|h| h * h).sum();
            let limit = 2.0 * (1.0 + alpha) / norm_squared;
            let [below, above] = [0.999, 1.001].map(|factor| {
                (rbf.eta, rbf.alpha) = (factor * limit, alpha);
                let mut rbf = rbf;
                for _ in 0..20_000 {
                    rbf.learn(1.0);
                }
                (rbf.output() - 1.0).abs()
            });
            assert!(below < 1e-3, "below the bound: {below}");
            assert!(above > 1e3 || above.is_nan(), "above the bound: {above}");
        }
    }

    /// A network with room for `N` nodes, of which some are in use, with different values for each.
    fn with_room<const N: usize>(nodes: u64) -> Rbf<N> {
        let mut rbf = Rbf {
            nodes,
            centres: centres(),
            widths: from_fn(|j| 0.5 + 0.01 * j as f64),
            initial_weights: from_fn(|j| libm::sin(j as f64)),
            eta: 0.3,
            alpha: 0.05,
            ..Default::default()
        };
        rbf.reset();
        rbf
    }

    /// Values of the set-point, of which some repeat, and of the target.
    fn samples() -> impl Iterator<Item = (f64, f64)> {
        (0..500).map(|k| {
            let time = f64::from(k / 2);
            (2.5 * libm::sin(0.1 * time), 10.0 * libm::cos(0.3 * time))
        })
    }

    /// (12) to (14), (18), (19) node by node, with the exponential function of libm.
    #[test]
    fn any_number_of_nodes_follows_the_equations() {
        for nodes in 0..=20 {
            let mut rbf = with_room::<20>(nodes);
            let used = 0..nodes as usize;
            let (mut w, mut before) = (rbf.weights, rbf.weights);
            for (r, target) in samples() {
                rbf.activate(r);
                let h: [f64; 20] = from_fn(|j| {
                    let distance = (r - rbf.centres[j]) / rbf.widths[j];
                    libm::exp(-distance * distance / 2.0)
                });
                let output: f64 = used.clone().map(|j| w[j] * h[j]).sum();
                assert!((rbf.output() - output).abs() < 1e-11, "{nodes} nodes");
                rbf.learn(target);
                for j in used.clone() {
                    let change = w[j] - before[j];
                    before[j] = w[j];
                    w[j] += 0.05 * change - 0.3 * (output - target) * h[j];
                    assert!((rbf.weights[j] - w[j]).abs() < 1e-11, "{nodes} nodes, {j}");
                }
            }
        }
    }

    #[test]
    fn nodes_that_join_start_with_their_initial_weights_and_without_momentum() {
        let mut rbf = with_room::<16>(4);
        for (r, target) in samples() {
            rbf.activate(r);
            rbf.learn(target);
        }
        let (w, before) = (rbf.weights, rbf.weights_before);

        rbf.nodes = 6;
        rbf.resize();
        assert_eq!(rbf.weights[..4], w[..4]);
        assert_eq!(rbf.weights[4..], rbf.initial_weights[4..]);
        rbf.activate(2.0); // the set-point may be the same as before
        assert_eq!(rbf.activations[3], 1.0);
        assert!(rbf.activations[4] > 0.1 && rbf.activations[6] == 0.0);
        rbf.learn(rbf.output()); // momentum alone
        assert_eq!(rbf.weights[0], w[0] + 0.05 * (w[0] - before[0]));
        assert_eq!(rbf.weights[4..], rbf.initial_weights[4..]);

        // Nodes that left have forgotten what they learned.
        rbf.learn(50.0);
        rbf.nodes = 2;
        rbf.resize();
        rbf.nodes = 6;
        rbf.resize();
        assert_eq!(rbf.weights[2..], rbf.initial_weights[2..]);
        assert_ne!(rbf.weights[0], rbf.initial_weights[0]);
    }

    #[test]
    fn more_nodes_than_there_is_room_for_count_as_all() {
        let (mut all, mut beyond) = (with_room::<4>(4), with_room::<4>(u64::MAX));
        for (r, target) in samples() {
            for rbf in [&mut all, &mut beyond] {
                rbf.activate(r);
                rbf.learn(target);
            }
        }
        assert_eq!(all.weights, beyond.weights);
    }
}
