//! PID-RBF (23), (24) and IPID-RBF (28), (29): a network that learns the control of a PID while it
//! runs, until it supplies the whole force and the PID's part is (nearly) zero.

use multiversion::{multiversion, target::match_target};

use crate::{Pid, Rbf, pid::Integral, vector::PAPER};

/// PID-RBF: the sum of a [`Pid`] and an [`Rbf`] network of `N` nodes that learns that sum.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "fmi", derive(fmu_derive::Variables), variables(crate = fmu_description))]
pub struct PidRbf<const N: usize> {
    /// The PID: gains, sample time, force limit, the force u = u_p + u_n, and the outputs `e` and `u_p`.
    #[cfg_attr(feature = "fmi", nested(flatten))]
    pub pid: Pid,
    /// The network's part of the force (N).
    #[cfg_attr(feature = "fmi", output(unit = "N", initially_from()))]
    pub u_n: f64,
    /// The network; its input is the set-point.
    #[cfg_attr(feature = "fmi", nested(prefix = "rbf"))]
    pub network: Rbf<N>,
}

impl<const N: usize> PidRbf<N> {
    /// Takes one sample (set-point `r`, measured angle `y`, its disturbance `d`, in rad) and returns
    /// the force u (N).
    #[inline(always)]
    pub fn sample(&mut self, r: f64, y: f64, d: f64) -> f64 {
        self.sample_towards(r, y, d, |force| force)
    }

    /// Takes one sample; the network learns the target of the force.
    #[inline(always)]
    fn sample_towards(&mut self, r: f64, y: f64, d: f64, target: impl Fn(f64) -> f64) -> f64 {
        match self.network.len() {
            PAPER => sample_in_one_vector(self, r, y, d, target),
            _ => self.sample_any(r, y, d, target),
        }
        self.pid.u
    }

    /// A sample of any number of nodes on any processor. Not inlined, so that the FMU's step can be.
    #[inline(never)]
    fn sample_any(&mut self, r: f64, y: f64, d: f64, target: impl Fn(f64) -> f64) {
        // Code for the paper's number of nodes, which is a constant in it.
        match self.network.len() {
            PAPER => self.sample_nodes(PAPER, r, y, d, target),
            n => self.sample_nodes(n, r, y, d, target),
        }
    }

    /// The control law (15), and a step of learning.
    #[inline(always)]
    fn sample_nodes(&mut self, n: usize, r: f64, y: f64, d: f64, target: impl Fn(f64) -> f64) {
        self.network.activate_first(n, r);
        self.u_n = self.network.output_of_first(n);
        self.pid.sample_with(r, y, d, self.u_n);
        self.network.descend(n, self.u_n - target(self.pid.u));
    }
}

/// A sample of the paper's number of nodes, which fit into one vector if the processor has AVX2.
#[multiversion(targets("x86_64+avx2"))]
fn sample_in_one_vector<const N: usize>(
    law: &mut PidRbf<N>,
    r: f64,
    y: f64,
    d: f64,
    target: impl Fn(f64) -> f64,
) {
    match_target! {
        "x86_64+avx2" => law.sample_nodes(PAPER, r, y, d, target),
        _ => law.sample_any(r, y, d, target),
    }
}

/// What the network of an [`IpidRbf`] learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "fmi", derive(fmu_derive::Choice), choice(crate = fmu_description))]
pub enum Target {
    /// The controller's own force, as printed in (29): a self-contained controller.
    #[default]
    Own,
    /// The force of a PID-RBF loop that runs in parallel, as in the simulations for Table 1.
    Supervisor,
}

/// IPID-RBF: [`PidRbf`] with a leaky sum of the error (26), so that the network does the integration.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct IpidRbf<const N: usize> {
    /// The control law: parameters and outputs.
    #[cfg_attr(feature = "fmi", nested(flatten))]
    pub law: PidRbf<N>,
    /// What the network learns.
    #[cfg_attr(feature = "fmi", parameter(name = "rbf.target"))]
    pub target: Target,
}

impl<const N: usize> Default for IpidRbf<N> {
    fn default() -> Self {
        Self {
            law: PidRbf { pid: Pid::new(Integral::Leaky), ..PidRbf::default() },
            target: Target::default(),
        }
    }
}

impl<const N: usize> IpidRbf<N> {
    /// Takes one sample as [`PidRbf::sample`] does; `u_supervisor` (N) is the force of the
    /// supervising loop at the same sample, used with [`Target::Supervisor`] only.
    #[inline(always)]
    pub fn sample(&mut self, r: f64, y: f64, d: f64, u_supervisor: f64) -> f64 {
        let target = self.target;
        self.law.sample_towards(r, y, d, move |force| match target {
            Target::Own => force,
            Target::Supervisor => u_supervisor,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_sample_learns_the_force_it_returned() {
        let mut law = PidRbf::<2>::default();
        law.pid.gains.kp = 300.0;
        (law.pid.ts, law.pid.u_max) = (0.001, 100.0);
        (law.network.eta, law.network.alpha) = (0.3, 0.05);
        for k in 0..100 {
            let r = libm::sin(0.1 * f64::from(k));
            let mut network = law.network;
            network.activate(r);
            let u = law.sample(r, 0.0, 0.0);
            network.learn(u);
            assert_eq!(law.network, network);
        }
    }
}
