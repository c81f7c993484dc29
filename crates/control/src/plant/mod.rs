//! The cart with the inverted pendulum, modelled in three ways.
//!
//! | model | equations | exact for |
//! |---|---|---|
//! | [`TransferFunction`] | the difference equation (41), `theta` only | the linear plant, held force, one `ts` |
//! | [`Linear`] | the state-space form of (9) | the linear plant, held or ramped force, any step |
//! | [`nonlinear`] | (7), (8), integrated with error control | |

mod exponential;
mod linear;
pub mod nonlinear;
mod transfer_function;

pub use linear::Linear;
pub use transfer_function::TransferFunction;

/// Parameters of the cart and the pendulum; see [`Parameters::PAPER`] for the values of section 4.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "fmi", derive(fmu_derive::Variables), variables(crate = fmu_description))]
#[allow(non_snake_case, reason = "the symbols of the paper")]
pub struct Parameters {
    /// Mass of the cart (kg).
    #[cfg_attr(
        feature = "fmi",
        parameter(start = Self::PAPER.M, min = 1e-6, max = 1e6, unit = "kg")
    )]
    pub M: f64,
    /// Mass of the pendulum (kg).
    #[cfg_attr(
        feature = "fmi",
        parameter(start = Self::PAPER.m, min = 1e-6, max = 1e6, unit = "kg")
    )]
    pub m: f64,
    /// Distance from the pivot to the pendulum's centre of mass (m).
    #[cfg_attr(
        feature = "fmi",
        parameter(start = Self::PAPER.l, min = 1e-3, max = 1e3, unit = "m")
    )]
    pub l: f64,
    /// Gravitational acceleration (m/s2).
    #[cfg_attr(
        feature = "fmi",
        parameter(start = Self::PAPER.g, min = 0, max = 1e3, unit = "m/s2")
    )]
    pub g: f64,
    /// Inertia of the pendulum about its centre of mass (kg.m2).
    #[cfg_attr(
        feature = "fmi",
        parameter(start = Self::PAPER.I, min = 0, max = 1e6, unit = "kg.m2")
    )]
    pub I: f64,
    /// Friction of the cart (N.s/m).
    #[cfg_attr(
        feature = "fmi",
        parameter(start = Self::PAPER.b, min = 0, max = 1e6, unit = "N.s/m")
    )]
    pub b: f64,
}

impl Parameters {
    /// The values of section 4.
    pub const PAPER: Self = Self { M: 1.096, m: 0.109, l: 0.25, g: 9.8, I: 0.0034, b: 0.1 };

    /// Static moment `m l` (kg m).
    fn ml(&self) -> f64 {
        self.m * self.l
    }

    /// Inertia about the pivot, `I + m l^2` (kg m^2).
    fn inertia(&self) -> f64 {
        self.I + self.m * self.l * self.l
    }

    /// `q = (M+m)(I+m l^2) - (m l)^2` of (11), the determinant of the mass matrix in the upright
    /// position.
    fn q(&self) -> f64 {
        (self.M + self.m) * self.inertia() - self.ml() * self.ml()
    }
}

/// The force on the cart over a step: u(t + tau) = value + slope tau.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Force {
    /// Value at the beginning of the step (N).
    pub value: f64,
    /// Derivative (N/s); 0 for a constant force.
    pub slope: f64,
}

impl From<f64> for Force {
    fn from(value: f64) -> Self {
        Self { value, slope: 0.0 }
    }
}

/// State of the cart and the pendulum.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// Position of the cart (m).
    pub x: f64,
    /// Velocity of the cart (m/s).
    pub v: f64,
    /// Angle of the pendulum from the upright (rad).
    pub theta: f64,
    /// Angular velocity of the pendulum (rad/s).
    pub omega: f64,
}

impl From<[f64; 4]> for State {
    #[inline(always)]
    fn from([x, v, theta, omega]: [f64; 4]) -> Self {
        Self { x, v, theta, omega }
    }
}

impl From<State> for [f64; 4] {
    #[inline(always)]
    fn from(s: State) -> Self {
        [s.x, s.v, s.theta, s.omega]
    }
}

/// Partial derivatives of the state's derivative (x', v', theta', omega'): each field is the vector of
/// derivatives with respect to one variable, so that `jacobian.theta.omega` is the derivative of omega' with respect
/// to theta.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Jacobian {
    /// With respect to the position of the cart (per m).
    pub x: State,
    /// With respect to the velocity of the cart (per m/s).
    pub v: State,
    /// With respect to the angle (per rad).
    pub theta: State,
    /// With respect to the angular velocity (per rad/s).
    pub omega: State,
    /// With respect to the force (per N).
    pub u: State,
}

#[cfg(test)]
mod tests {
    use super::*;

    const P: Parameters = Parameters::PAPER;

    /// A state far from the upright position, and a force.
    const SWING: [f64; 5] = [0.3, 0.5, 2.0, -1.5, 3.0];

    fn check_by_central_differences(
        derivative: impl Fn(&State, f64) -> State,
        jacobian: &Jacobian,
    ) {
        let at = |[x, v, theta, omega, u]: [f64; 5]| {
            <[f64; 4]>::from(derivative(&[x, v, theta, omega].into(), u))
        };
        let Jacobian { x, v, theta, omega, u } = *jacobian;
        for (j, column) in [x, v, theta, omega, u].map(<[f64; 4]>::from).iter().enumerate() {
            let [above, below] = [1e-4, -1e-4].map(|delta| {
                let mut moved = SWING;
                moved[j] += delta;
                at(moved)
            });
            for i in 0..4 {
                let difference = (above[i] - below[i]) / 2e-4;
                let error = (column[i] - difference).abs();
                assert!(error < 1e-6, "derivative {i} by variable {j}: {column:?}");
            }
        }
    }

    #[test]
    fn the_jacobians_match_central_differences() {
        let linear = Linear::new(&P);
        check_by_central_differences(|s, u| linear.derivative(s, u), &linear.jacobian());
        let [x, v, theta, omega, u] = SWING;
        check_by_central_differences(
            |s, u| nonlinear::derivative(&P, s, u),
            &nonlinear::jacobian(&P, &[x, v, theta, omega].into(), u),
        );
    }

    #[test]
    fn the_derivatives_satisfy_the_printed_equations() {
        let [x, v, theta, omega, u] = SWING;
        let s = State::from([x, v, theta, omega]);
        let residuals = |derivative: State, sin: f64, cos: f64, centrifugal: f64| {
            let (xdd, thetadd) = (derivative.v, derivative.omega);
            let ml = P.m * P.l;
            assert_eq!((derivative.x, derivative.theta), (v, omega));
            [
                (P.M + P.m) * xdd - ml * thetadd * cos + ml * centrifugal + P.b * v - u,
                (P.I + ml * P.l) * thetadd - ml * P.g * sin - ml * xdd * cos,
            ]
        };
        let (sin, cos) = (libm::sin(theta), libm::cos(theta));
        let full = nonlinear::derivative(&P, &s, u);
        let linear = Linear::new(&P).derivative(&s, u);
        for residual in [
            residuals(full, sin, cos, omega * omega * sin), // (7), (8)
            residuals(linear, theta, 1.0, 0.0),             // (9)
        ]
        .concat()
        {
            assert!(residual.abs() < 1e-14, "{residual}");
        }
    }

    /// The ends of a motion of the nonlinear and of the linear plant from the same state.
    fn ends(start: State, u: Force, step: f64) -> [[f64; 4]; 2] {
        let (mut full, mut linear) = (start, start);
        nonlinear::advance(&P, &mut full, u, step).unwrap();
        Linear::new(&P).advance(&mut linear, u, step);
        [full, linear].map(Into::into)
    }

    #[test]
    fn a_ramp_of_the_force_is_the_limit_of_many_held_steps() {
        let (n, step) = (4096, 0.5);
        let mut repeated = [State::from([0.3, -0.2, 0.05, 0.1]); 2];
        let single = ends(repeated[0], Force { value: 1.0, slope: 4.0 }, step);
        let small = step / f64::from(n);
        for k in 0..n {
            // The value in the middle of each small step: second order.
            let middle = Force::from(1.0 + 4.0 * (f64::from(k) + 0.5) * small);
            let [full, linear] = repeated;
            repeated = [ends(full, middle, small)[0].into(), ends(linear, middle, small)[1].into()];
        }
        for (single, repeated) in single.into_iter().zip(repeated) {
            let repeated: [f64; 4] = repeated.into();
            assert!((0..4).all(|i| (single[i] / repeated[i] - 1.0).abs() < 1e-6));
        }
    }
}
