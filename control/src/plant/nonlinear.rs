//! The nonlinear plant (7), (8), integrated by the embedded Runge-Kutta pair 5(4) of Dormand and
//! Prince (J. Comput. Appl. Math. 6, 1980), local extrapolation, error per substep controlled.

use super::{Parameters, State};

/// Accepted error of a substep, relative to the size of each state plus [`ABSOLUTE`].
const RELATIVE: f64 = 1e-11;
/// Accepted error of a substep where a state is near zero (m, m/s, rad, rad/s).
const ABSOLUTE: f64 = 1e-13;
/// More substeps than this in one step are refused: the motion is too fast to be followed.
const MOST_SUBSTEPS: u32 = 1_000_000;

/// Why a step of the nonlinear plant could not be computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepFailure {
    /// How far into the step the integration came (s).
    pub reached: f64,
}

impl core::fmt::Display for StepFailure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "the motion became too fast to be integrated {} s into the step",
            self.reached
        )
    }
}

impl core::error::Error for StepFailure {}

/// The four states as an array, the form in which Runge-Kutta sums them.
type Vector = [f64; 4];

/// Moves `state` on by `step` (s) under the held force `u` (N).
///
/// # Errors
/// [`StepFailure`] when the state leaves the finite numbers or changes too fast; `state` is then
/// unchanged.
pub fn advance(p: &Parameters, state: &mut State, u: f64, step: f64) -> Result<(), StepFailure> {
    let mut y = [state.x, state.v, state.theta, state.omega];
    let mut reached = 0.0;
    let mut h = step;
    for _ in 0..MOST_SUBSTEPS {
        let remaining = step - reached;
        if remaining <= 0.0 {
            let [x, v, theta, omega] = y;
            *state = State { x, v, theta, omega };
            return Ok(());
        }
        h = h.min(remaining);
        let (next, error) = substep(p, &y, u, h);
        if error <= 1.0 {
            reached = if h == remaining { step } else { reached + h };
            y = next;
        }
        // Standard step-size control; NaN and infinity shrink the substep.
        let factor = 0.9 * libm::pow(error.max(1e-10), -0.2);
        h *= if factor.is_finite() {
            factor.clamp(0.2, 5.0)
        } else {
            0.2
        };
        if reached + h == reached {
            break;
        }
    }
    Err(StepFailure { reached })
}

/// Accelerations from (7), (8), which are linear in them: Cramer's rule.
fn derivative(p: &Parameters, [_, v, theta, omega]: Vector, u: f64) -> Vector {
    let (sin, cos) = libm::sincos(theta);
    let (total, ml, inertia) = (p.M + p.m, p.ml(), p.inertia());
    let coupling = ml * cos;
    let force = u - p.b * v - ml * omega * omega * sin;
    let torque = ml * p.g * sin;
    let determinant = total * inertia - coupling * coupling;
    [
        v,
        (inertia * force + coupling * torque) / determinant,
        omega,
        (coupling * force + total * torque) / determinant,
    ]
}

/// One substep of size `h`: the state of fifth order, and its error in units of what is accepted.
fn substep(p: &Parameters, y: &Vector, u: f64, h: f64) -> (Vector, f64) {
    const A: [&[f64]; 7] = [
        &[],
        &[1.0 / 5.0],
        &[3.0 / 40.0, 9.0 / 40.0],
        &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
        &[
            19372.0 / 6561.0,
            -25360.0 / 2187.0,
            64448.0 / 6561.0,
            -212.0 / 729.0,
        ],
        &[
            9017.0 / 3168.0,
            -355.0 / 33.0,
            46732.0 / 5247.0,
            49.0 / 176.0,
            -5103.0 / 18656.0,
        ],
        &[
            35.0 / 384.0,
            0.0,
            500.0 / 1113.0,
            125.0 / 192.0,
            -2187.0 / 6784.0,
            11.0 / 84.0,
        ],
    ];
    /// Weights of fifth order less those of fourth.
    const E: [f64; 7] = [
        71.0 / 57600.0,
        0.0,
        -71.0 / 16695.0,
        71.0 / 1920.0,
        -17253.0 / 339200.0,
        22.0 / 525.0,
        -1.0 / 40.0,
    ];
    let mut slopes = [[0.0; 4]; 7];
    let mut stage = *y;
    for (s, row) in A.iter().enumerate() {
        stage = add(y, h, row, &slopes);
        slopes[s] = derivative(p, stage, u);
    }
    let error = add(&[0.0; 4], h, &E, &slopes);
    let mut squares = 0.0;
    for i in 0..4 {
        let accepted = ABSOLUTE + RELATIVE * y[i].abs().max(stage[i].abs());
        // Added, not compared: `max` would hide a NaN.
        let r = error[i] / accepted;
        squares += r * r;
    }
    (stage, libm::sqrt(squares / 4.0))
}

/// `y + h sum_s weights(s) slopes(s)`.
fn add(y: &Vector, h: f64, weights: &[f64], slopes: &[Vector; 7]) -> Vector {
    core::array::from_fn(|i| {
        let slope: f64 = weights.iter().zip(slopes).map(|(w, k)| w * k[i]).sum();
        y[i] + h * slope
    })
}

#[cfg(test)]
mod tests {
    use super::super::Linear;
    use super::*;

    const SWING: State = State {
        x: 0.0,
        v: 0.5,
        theta: 2.0,
        omega: -1.0,
    };

    /// Kinetic and potential energy, of which (7), (8) are the Lagrange equations.
    fn energy(p: &Parameters, s: &State) -> f64 {
        let cos = libm::cos(s.theta);
        0.5 * (p.M + p.m) * s.v * s.v - p.ml() * cos * s.v * s.omega
            + 0.5 * p.inertia() * s.omega * s.omega
            + p.ml() * p.g * cos
    }

    #[test]
    fn energy_is_conserved_without_friction_and_force() {
        let p = Parameters {
            b: 0.0,
            ..Parameters::PAPER
        };
        let mut state = SWING;
        let before = energy(&p, &state);
        for _ in 0..20_000 {
            advance(&p, &mut state, 0.0, 0.001).unwrap();
        }
        assert!((energy(&p, &state) / before - 1.0).abs() < 1e-9);
        assert!((state.theta - SWING.theta).abs() > 0.1, "it moves");
    }

    #[test]
    fn friction_takes_the_energy_that_its_force_works() {
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
    fn small_angles_tend_to_the_linear_plant_with_the_third_power() {
        let difference = |theta: f64| {
            let start = State {
                theta,
                ..State::default()
            };
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
            let mut y = [SWING.x, SWING.v, SWING.theta, SWING.omega];
            for _ in 0..n {
                y = substep(&Parameters::PAPER, &y, 1.0, 1.0 / f64::from(n)).0;
            }
            y[2]
        };
        let exact = end(4096);
        let order = libm::log2((end(256) - exact).abs() / (end(512) - exact).abs());
        assert!((order - 5.0).abs() < 0.2, "order {order}");
    }

    #[test]
    fn a_long_step_equals_many_short_ones() {
        let (mut once, mut often) = (SWING, SWING);
        advance(&Parameters::PAPER, &mut once, 1.0, 2.0).unwrap();
        for _ in 0..2000 {
            advance(&Parameters::PAPER, &mut often, 1.0, 0.001).unwrap();
        }
        assert!(
            (once.theta - often.theta).abs() < 1e-8,
            "{once:?} {often:?}"
        );
    }

    #[test]
    fn what_is_not_finite_is_told_and_changes_nothing() {
        for u in [f64::NAN, f64::INFINITY, 1e308] {
            let mut state = SWING;
            assert!(advance(&Parameters::PAPER, &mut state, u, 0.1).is_err());
            assert_eq!(state, SWING);
        }
    }
}
