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
    pub const PAPER: Self = Self {
        M: 1.096,
        m: 0.109,
        l: 0.25,
        g: 9.8,
        I: 0.0034,
        b: 0.1,
    };

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
