//! The nonlinear plant (7), (8), integrated by the method of [Dormand and Prince](ode_methods::dormand_prince) with
//! local extrapolation and error control per substep.

use ode_methods::dormand_prince::{ERROR, NODES, STAGES, WEIGHTS, factor, weighted};

use super::{Force, Jacobian, Parameters, State};

/// Relative tolerance of a substep; an absolute one of 1e-13 (m, m/s, rad, rad/s) is added for each
/// state.
pub const RELATIVE: f64 = 1e-11;
/// Absolute tolerance of a substep (m, m/s, rad, rad/s).
const ABSOLUTE: f64 = 1e-13;
/// Maximum number of substeps in one step; beyond it, the motion is too fast to integrate.
const MAX_SUBSTEPS: u32 = 1_000_000;

/// Why a step of the nonlinear plant could not be computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepFailure {
    /// The time into the step that the integration reached (s).
    pub reached: f64,
}

impl core::fmt::Display for StepFailure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the motion became too fast to integrate {} s into the step", self.reached)
    }
}

impl core::error::Error for StepFailure {}

/// Advances `state` by `step` (s) under the force `u`.
///
/// # Errors
/// [`StepFailure`] if the state becomes non-finite or changes too fast; `state` is then unchanged.
pub fn advance(
    p: &Parameters,
    state: &mut State,
    u: impl Into<Force>,
    step: f64,
) -> Result<(), StepFailure> {
    let u = u.into();
    let force = |tau| u.value + u.slope * tau;
    *state = integrate((*state).into(), step, |tau, y| slope(p, y, force(tau)))?.into();
    Ok(())
}

/// The derivative (x', v', theta', omega') of `state` under the force `u` (N).
pub fn derivative(p: &Parameters, state: &State, u: f64) -> State {
    slope(p, &(*state).into(), u).into()
}

/// The partial derivatives of [`derivative`] at `state` under the force `u` (N).
pub fn jacobian(p: &Parameters, state: &State, u: f64) -> Jacobian {
    let by = |dy, du| variation(p, &(*state).into(), u, &dy, du).into();
    Jacobian {
        x: by([1.0, 0.0, 0.0, 0.0], 0.0),
        v: by([0.0, 1.0, 0.0, 0.0], 0.0),
        theta: by([0.0, 0.0, 1.0, 0.0], 0.0),
        omega: by([0.0, 0.0, 0.0, 1.0], 0.0),
        u: by([0.0; 4], 1.0),
    }
}

/// Terms of the accelerations at a state (x, v, theta, omega) and a force.
struct Balance {
    sin: f64,
    cos: f64,
    /// m l cos(theta).
    coupling: f64,
    force: f64,
    torque: f64,
    determinant: f64,
}

impl Balance {
    fn new(p: &Parameters, [_, v, theta, omega]: &[f64; 4], u: f64) -> Self {
        let (sin, cos) = libm::sincos(*theta);
        let coupling = p.ml() * cos;
        Self {
            sin,
            cos,
            coupling,
            force: u - p.b * v - p.ml() * omega * omega * sin,
            torque: p.ml() * p.g * sin,
            determinant: (p.M + p.m) * p.inertia() - coupling * coupling,
        }
    }
}

/// The derivative of the state. (7), (8) are linear in the accelerations: Cramer's rule.
fn slope(p: &Parameters, y: &[f64; 4], u: f64) -> [f64; 4] {
    let q = Balance::new(p, y, u);
    [
        y[1],
        (p.inertia() * q.force + q.coupling * q.torque) / q.determinant,
        y[3],
        (q.coupling * q.force + (p.M + p.m) * q.torque) / q.determinant,
    ]
}

/// The derivative of [`slope`] in the direction of `dy` for the state and `du` for the force.
fn variation(p: &Parameters, y: &[f64; 4], u: f64, dy: &[f64; 4], du: f64) -> [f64; 4] {
    let q = Balance::new(p, y, u);
    let [_, x_acceleration, omega, theta_acceleration] = slope(p, y, u);
    let [_, dv, dtheta, domega] = *dy;
    let ml = p.ml();
    let dcoupling = -ml * q.sin * dtheta;
    let dforce = du - p.b * dv - ml * omega * (2.0 * q.sin * domega + omega * q.cos * dtheta);
    let dtorque = ml * p.g * q.cos * dtheta;
    let ddeterminant = -2.0 * q.coupling * dcoupling;
    [
        dv,
        (p.inertia() * dforce + dcoupling * q.torque + q.coupling * dtorque
            - x_acceleration * ddeterminant)
            / q.determinant,
        domega,
        (dcoupling * q.force + q.coupling * dforce + (p.M + p.m) * dtorque
            - theta_acceleration * ddeterminant)
            / q.determinant,
    ]
}

/// Integrates y' = slope(tau, y) from tau = 0 to `step`.
fn integrate<const N: usize>(
    mut y: [f64; N],
    step: f64,
    slope: impl Fn(f64, &[f64; N]) -> [f64; N],
) -> Result<[f64; N], StepFailure> {
    let mut reached = 0.0;
    let mut h = step;
    for _ in 0..MAX_SUBSTEPS {
        let remaining = step - reached;
        if remaining <= 0.0 {
            return Ok(y);
        }
        h = h.min(remaining);
        let (next, error) = substep(&y, h, |tau, y| slope(reached + tau, y));
        if error <= 1.0 {
            reached = if h == remaining { step } else { reached + h };
            y = next;
        }
        h *= factor(error);
        if reached + h == reached {
            break;
        }
    }
    Err(StepFailure { reached })
}

/// One substep of size `h`: the fifth-order state, and its error relative to the tolerance.
fn substep<const N: usize>(
    y: &[f64; N],
    h: f64,
    slope: impl Fn(f64, &[f64; N]) -> [f64; N],
) -> ([f64; N], f64) {
    let mut slopes = [[0.0; N]; STAGES];
    let mut stage = *y;
    for (s, row) in WEIGHTS.iter().enumerate() {
        stage = add(y, h, row, &slopes);
        slopes[s] = slope(NODES[s] * h, &stage);
    }
    let error = add(&[0.0; N], h, &ERROR, &slopes);
    let mut squares = 0.0;
    for i in 0..N {
        let tolerance = ABSOLUTE + RELATIVE * y[i].abs().max(stage[i].abs());
        // A sum, not a maximum: `max` would hide a NaN.
        let r = error[i] / tolerance;
        squares += r * r;
    }
    (stage, libm::sqrt(squares / N as f64))
}

/// `y + h sum_s weights[s] slopes[s]`.
fn add<const N: usize>(
    y: &[f64; N],
    h: f64,
    weights: &[f64],
    slopes: &[[f64; N]; STAGES],
) -> [f64; N] {
    core::array::from_fn(|i| y[i] + h * weighted(weights, slopes, i))
}

#[cfg(test)]
mod tests {
    use super::super::Linear;
    use super::*;

    const SWING: State = State { x: 0.0, v: 0.5, theta: 2.0, omega: -1.0 };

    /// Kinetic plus potential energy; (7), (8) are its Lagrange equations.
    fn energy(p: &Parameters, s: &State) -> f64 {
        let cos = libm::cos(s.theta);
        0.5 * (p.M + p.m) * s.v * s.v - p.ml() * cos * s.v * s.omega
            + 0.5 * p.inertia() * s.omega * s.omega
            + p.ml() * p.g * cos
    }

    #[test]
    fn the_energy_changes_by_the_work_of_force_and_friction() {
        // dE/dt = u v - b v^2, by the trapezoidal rule over small steps.
        let (p, u) = (Parameters::PAPER, 2.0);
        let (mut state, mut work) = (SWING, 0.0);
        let before = energy(&p, &state);
        for _ in 0..20_000 {
            let power = |s: &State| u * s.v - p.b * s.v * s.v;
            let start = power(&state);
            advance(&p, &mut state, u, 1e-4).unwrap();
            work += 0.5e-4 * (start + power(&state));
        }
        assert!((energy(&p, &state) - before - work).abs() < 1e-6);
    }

    /// The first neglected terms are cubic in the angle, so the difference falls as its cube.
    #[test]
    fn the_difference_from_the_linear_plant_is_cubic_in_the_angle() {
        let difference = |theta: f64| {
            let start = State { theta, ..State::default() };
            let (mut full, mut linear) = (start, start);
            advance(&Parameters::PAPER, &mut full, 0.0, 0.2).unwrap();
            Linear::new(&Parameters::PAPER).advance(&mut linear, 0.0, 0.2);
            (full.theta - linear.theta).abs()
        };
        let order = libm::log2(difference(0.02) / difference(0.01));
        assert!((order - 3.0).abs() < 0.01, "order {order}");
    }

    #[test]
    fn the_method_is_of_fifth_order() {
        let end = |n: u32| {
            let mut y = <[f64; 4]>::from(SWING);
            for _ in 0..n {
                let slope = |_, y: &[f64; 4]| self::slope(&Parameters::PAPER, y, 1.0);
                y = substep(&y, 1.0 / f64::from(n), slope).0;
            }
            y[2]
        };
        let exact = end(4096);
        let order = libm::log2((end(256) - exact).abs() / (end(512) - exact).abs());
        assert!((order - 5.0).abs() < 0.2, "order {order}");
    }

    /// A step of 1e6 s: the first trial substep overflows, and later ones adapt their size.
    #[test]
    fn a_substep_that_overflows_is_retried_with_a_smaller_size() {
        let p = Parameters { b: 100.0, ..Parameters::PAPER };
        let mut state = State { theta: 3.0, ..State::default() };
        let failure = advance(&p, &mut state, 0.0, 1e6).unwrap_err();
        assert!(failure.reached > 1.0, "{failure:?}");
    }

    #[test]
    fn non_finite_input_is_an_error_and_changes_nothing() {
        for u in [f64::NAN, f64::INFINITY, 1e308] {
            let mut state = SWING;
            assert!(advance(&Parameters::PAPER, &mut state, u, 0.1).is_err());
            assert_eq!(state, SWING);
        }
    }
}
