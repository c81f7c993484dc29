//! The linear plant in state space, integrated exactly.

use nalgebra::{Matrix4, Matrix6, Vector4};

use super::{Force, Jacobian, Parameters, State, exponential::expm1};

/// The linear plant (9) with the state (x, v, theta, omega), exact for a force that is constant or
/// changes linearly over a step.
///
/// The transition matrices of a step are a matrix exponential, cached until the step size changes.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(from = "Parameters", into = "Parameters")
)]
pub struct Linear {
    parameters: Parameters,
    /// The step size (s) of `transition`.
    step: f64,
    transition: Transition,
}

/// The state after a step: s + increment s + held u + ramp u'.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Transition {
    /// exp(A step) - I.
    increment: Matrix4<f64>,
    held: Vector4<f64>,
    ramp: Vector4<f64>,
}

impl Transition {
    /// Written out because the compiler does not unroll matrix products when it optimizes for size.
    #[inline(always)]
    fn apply(&self, state: &mut State, u: Force) {
        let State { x, v, theta, omega } = *state;
        let change = |i: usize| {
            let row = |j: usize| self.increment[(i, j)];
            row(0) * x
                + row(1) * v
                + row(2) * theta
                + row(3) * omega
                + self.held[i] * u.value
                + self.ramp[i] * u.slope
        };
        // The increment is added last: at small steps, I + increment would lose digits.
        state.x = x + change(0);
        state.v = v + change(1);
        state.theta = theta + change(2);
        state.omega = omega + change(3);
    }
}

impl From<Parameters> for Linear {
    fn from(parameters: Parameters) -> Self {
        Self {
            parameters,
            step: 0.0,
            transition: Transition {
                increment: Matrix4::zeros(),
                held: Vector4::zeros(),
                ramp: Vector4::zeros(),
            },
        }
    }
}

impl From<Linear> for Parameters {
    fn from(plant: Linear) -> Self {
        plant.parameters
    }
}

impl Linear {
    /// The plant with the given parameters.
    pub fn new(parameters: &Parameters) -> Self {
        Self::from(*parameters)
    }

    /// Advances `state` by `step` (s) under the force `u`.
    #[inline(always)]
    pub fn advance(&mut self, state: &mut State, u: impl Into<Force>, step: f64) {
        // The cache key, not a comparison of times: any other step has another transition.
        if step != self.step {
            self.prepare(step);
        }
        self.transition.apply(state, u.into());
    }

    #[inline(never)]
    fn prepare(&mut self, step: f64) {
        self.transition = transition(&self.jacobian(), step);
        self.step = step;
    }

    /// The derivative (x', v', theta', omega') of `state` under the force `u` (N).
    pub fn derivative(&self, state: &State, u: f64) -> State {
        let j = self.jacobian();
        let State { v, theta, omega, .. } = *state;
        State {
            x: v,
            v: j.v.v * v + j.theta.v * theta + j.u.v * u,
            theta: omega,
            omega: j.v.omega * v + j.theta.omega * theta + j.u.omega * u,
        }
    }

    /// The partial derivatives of [`Linear::derivative`], the same for all states and forces: A and B of
    /// s' = A s + B u from (9), solved for x'' and theta''.
    pub fn jacobian(&self) -> Jacobian {
        let p = &self.parameters;
        let (ml, inertia, q) = (p.ml(), p.inertia(), p.q());
        Jacobian {
            v: [1.0, -p.b * inertia / q, 0.0, -p.b * ml / q].into(),
            theta: [0.0, ml * ml * p.g / q, 0.0, (p.M + p.m) * ml * p.g / q].into(),
            omega: [0.0, 0.0, 1.0, 0.0].into(),
            u: [0.0, inertia / q, 0.0, ml / q].into(),
            ..Jacobian::default()
        }
    }
}

/// One step of s' = A s + B u with u' constant: exp of ((A, B, 0), (0, 0, 1), (0, 0, 0)) times the step.
fn transition(j: &Jacobian, step: f64) -> Transition {
    let (u, slope) = (4, 5);
    let mut generator = Matrix6::zeros();
    for (column, derivatives) in [j.x, j.v, j.theta, j.omega, j.u].iter().enumerate() {
        generator
            .fixed_view_mut::<4, 1>(0, column)
            .copy_from_slice(&<[f64; 4]>::from(*derivatives));
    }
    generator[(u, slope)] = 1.0;
    let moved = expm1(&(generator * step));
    Transition {
        increment: moved.fixed_view::<4, 4>(0, 0).into(),
        held: moved.fixed_view::<4, 1>(0, u).into(),
        ramp: moved.fixed_view::<4, 1>(0, slope).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_written_out_product_equals_the_matrix_product() {
        let t = transition(&Linear::new(&Parameters::PAPER).jacobian(), 0.01);
        let u = Force { value: 3.0, slope: -7.0 };
        let start = [0.3, -0.2, 0.05, 0.1];
        let mut state = State::from(start);
        t.apply(&mut state, u);
        let s = Vector4::from(start);
        let s = s + (t.increment * s + t.held * u.value + t.ramp * u.slope);
        assert_eq!(<[f64; 4]>::from(state), <[f64; 4]>::from(s));
    }

    #[test]
    fn a_cart_without_pendulum_follows_the_closed_form() {
        // m = 0: v = u/b (1 - exp(-b t/M)).
        let p = Parameters { m: 0.0, ..Parameters::PAPER };
        let mut state = State::default();
        Linear::new(&p).advance(&mut state, 2.0, 1.5);
        let expected = 2.0 / p.b * (1.0 - libm::exp(-p.b * 1.5 / p.M));
        assert!((state.v - expected).abs() < 1e-12);
    }
}
