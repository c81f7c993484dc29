//! The linear plant in state space, stepped exactly.

use nalgebra::{Matrix4, Matrix5, Vector4};

use super::{Parameters, State, exponential::expm1};

/// The linear plant (9) with the state (x, v, theta, omega), exact for a force held over a step.
///
/// The transition of a step is a matrix exponential, computed when the step changes, and kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Linear {
    a: Matrix4<f64>,
    b: Vector4<f64>,
    /// The step (s) that `increment` and `input` belong to.
    step: f64,
    /// exp(A step) - I.
    increment: Matrix4<f64>,
    input: Vector4<f64>,
}

impl Linear {
    /// The plant with the given parameters: `x' = A x + B u` from (9), solved for x'' and theta''.
    pub fn new(parameters: &Parameters) -> Self {
        let p = parameters;
        let (ml, inertia, q) = (p.ml(), p.inertia(), p.q());
        #[rustfmt::skip]
        let a = Matrix4::new(
            0.0, 1.0, 0.0, 0.0,
            0.0, -p.b * inertia / q, ml * ml * p.g / q, 0.0,
            0.0, 0.0, 0.0, 1.0,
            0.0, -p.b * ml / q, (p.M + p.m) * ml * p.g / q, 0.0,
        );
        Self {
            a,
            b: Vector4::new(0.0, inertia / q, 0.0, ml / q),
            step: 0.0,
            increment: Matrix4::zeros(),
            input: Vector4::zeros(),
        }
    }

    /// Moves `state` on by `step` (s) under the held force `u` (N).
    pub fn advance(&mut self, state: &mut State, u: f64, step: f64) {
        // A key of the cache, not a comparison of times: any other step has other matrices.
        if step != self.step {
            self.discretize(step);
        }
        let s = Vector4::new(state.x, state.v, state.theta, state.omega);
        // The increment is added last: at small steps the sum I + increment would lose its digits.
        let s = s + (self.increment * s + self.input * u);
        *state = State {
            x: s[0],
            v: s[1],
            theta: s[2],
            omega: s[3],
        };
    }

    /// Zero-order hold: exp([A B; 0 0] h) = [Ad Bd; 0 1].
    fn discretize(&mut self, step: f64) {
        let mut generator = Matrix5::zeros();
        generator.fixed_view_mut::<4, 4>(0, 0).copy_from(&self.a);
        generator.fixed_view_mut::<4, 1>(0, 4).copy_from(&self.b);
        let hold = expm1(&(generator * step));
        self.increment = hold.fixed_view::<4, 4>(0, 0).into();
        self.input = hold.fixed_view::<4, 1>(0, 4).into();
        self.step = step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: State = State {
        x: 0.3,
        v: -0.2,
        theta: 0.05,
        omega: 0.1,
    };

    #[test]
    fn one_step_equals_many_small_ones() {
        let mut plant = Linear::new(&Parameters::PAPER);
        let mut once = START;
        plant.advance(&mut once, 3.0, 0.5);
        let mut often = START;
        for _ in 0..512 {
            plant.advance(&mut often, 3.0, 0.5 / 512.0);
        }
        assert!((once.theta / often.theta - 1.0).abs() < 1e-12);
        assert!((once.x / often.x - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_derivative_is_that_of_the_printed_equations() {
        // A small step's difference quotient, put into (9).
        let (p, u, h) = (Parameters::PAPER, 3.0, 1e-6);
        let mut after = START;
        Linear::new(&p).advance(&mut after, u, h);
        let (xdd, thetadd) = ((after.v - START.v) / h, (after.omega - START.omega) / h);
        let cart = (p.M + p.m) * xdd + p.b * START.v - p.m * p.l * thetadd - u;
        let rod =
            (p.I + p.m * p.l * p.l) * thetadd - p.m * p.g * p.l * START.theta - p.m * p.l * xdd;
        assert!(cart.abs() < 1e-5 && rod.abs() < 1e-5, "{cart} {rod}");
    }

    #[test]
    fn without_pendulum_the_cart_follows_its_closed_form() {
        // m = 0: v = u/b (1 - exp(-b t/M)).
        let p = Parameters {
            m: 0.0,
            ..Parameters::PAPER
        };
        let mut state = State::default();
        Linear::new(&p).advance(&mut state, 2.0, 1.5);
        let expected = 2.0 / p.b * (1.0 - libm::exp(-p.b * 1.5 / p.M));
        assert!((state.v - expected).abs() < 1e-12);
    }
}
