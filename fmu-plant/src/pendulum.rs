//! The three models of the pendulum behind one interface.

use fmu_export::prelude::*;
use pendulum_control::plant::{
    Force, Jacobian, Linear, Parameters, State, TransferFunction, nonlinear,
};
use serde::{Deserialize, Serialize};

/// Cart with an inverted pendulum
#[derive(Model)]
#[model(continuous, step = Self::step, tolerance = nonlinear::RELATIVE)]
pub struct Pendulum {
    /// Force on the cart
    #[input(unit = "N", derivative = self.u_slope, terminal = "loop.u")]
    u: f64,
    u_slope: f64,
    /// Angle of the pendulum from the upright
    #[output(state, unit = "rad", initially_from("theta0"), terminal = "loop.y")]
    theta: f64,
    /// Angular velocity of the pendulum
    #[output(state, unit = "rad/s", initially_from("omega0", "dynamics"))]
    omega: f64,
    /// Position of the cart
    #[output(state, unit = "m", initially_from("x0", "dynamics"))]
    x: f64,
    /// Velocity of the cart
    #[output(state, unit = "m/s", initially_from("v0", "dynamics"))]
    v: f64,
    #[nested(flatten)]
    parameters: Parameters,
    /// Angle at the start
    #[parameter(min = -1e3, max = 1e3, unit = "rad")]
    theta0: f64,
    /// Angular velocity at the start
    #[parameter(min = -1e3, max = 1e3, unit = "rad/s")]
    omega0: f64,
    /// Position of the cart at the start
    #[parameter(min = -1e6, max = 1e6, unit = "m")]
    x0: f64,
    /// Velocity of the cart at the start
    #[parameter(min = -1e6, max = 1e6, unit = "m/s")]
    v0: f64,
    /// Sample time of the transfer function
    #[parameter(start = 0.001, min = 1e-6, max = 1, unit = "s")]
    ts: f64,
    /// Form of the plant
    #[parameter(start = PlantModel::Linear)]
    dynamics: PlantModel,
    #[derivative(of = theta, unit = "rad/s", derivative_by(omega = self.jacobian().omega.theta))]
    theta_dot: f64,
    #[derivative(
        of = omega,
        unit = "rad/s2",
        derivative_by(
            theta = self.jacobian().theta.omega,
            omega = self.jacobian().omega.omega,
            v = self.jacobian().v.omega,
            u = self.jacobian().u.omega
        )
    )]
    omega_dot: f64,
    #[derivative(of = x, unit = "m/s", derivative_by(v = self.jacobian().v.x))]
    x_dot: f64,
    #[derivative(
        of = v,
        unit = "m/s2",
        derivative_by(
            theta = self.jacobian().theta.v,
            omega = self.jacobian().omega.v,
            v = self.jacobian().v.v,
            u = self.jacobian().u.v
        )
    )]
    v_dot: f64,
    selected: Selected,
    /// The size of the last step (s).
    last_step: f64,
}

/// Form of the plant
#[derive(Clone, Copy, Choice)]
enum PlantModel {
    /// Difference equation (41) at the sample time ts; theta only
    TransferFunction,
    /// Linear state space (9), exact for any step
    Linear,
    /// Equations (7), (8), integrated with error control
    Nonlinear,
}

/// The selected model of the plant, created at initialization.
#[derive(Default, Clone, Serialize, Deserialize)]
enum Selected {
    TransferFunction(TransferFunction),
    Linear(Box<Linear>),
    #[default]
    Nonlinear,
}

/// Maximum number of samples of the transfer function in one step.
const MAX_SAMPLES: f64 = 1e8;

impl Continuous for Pendulum {
    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        let mut state = State::from([self.x0, self.v0, self.theta0, self.omega0]);
        self.selected = match self.dynamics {
            PlantModel::TransferFunction if start.is_model_exchange => {
                return Err(ModelError::refuse(
                    "dynamics = transfer_function is a difference equation without derivatives; for model exchange, expected linear or nonlinear",
                ));
            }
            PlantModel::TransferFunction => {
                let plant = TransferFunction::new(&self.parameters, self.ts, state);
                state = State { theta: plant.theta(), ..State::default() };
                Selected::TransferFunction(plant)
            }
            PlantModel::Linear => Selected::Linear(Box::new(Linear::new(&self.parameters))),
            PlantModel::Nonlinear => Selected::Nonlinear,
        };
        self.set_state(state);
        Ok(())
    }

    /// With the transfer function, the derivatives are not computed and stay 0.
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        let state = self.state();
        let derivative = match &self.selected {
            Selected::TransferFunction(_) => State::default(),
            Selected::Linear(plant) => plant.derivative(&state, self.u),
            Selected::Nonlinear => nonlinear::derivative(&self.parameters, &state, self.u),
        };
        [self.x_dot, self.v_dot, self.theta_dot, self.omega_dot] = derivative.into();
        Ok(())
    }
}

impl Pendulum {
    /// Takes a step of co-simulation, exactly for the linear models.
    fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
        // A step like the last one is already snapped if needed.
        if self.last_step != step {
            self.last_step = snap(step, self.ts);
        }
        self.advance(self.last_step)
    }

    #[inline(always)]
    fn state(&self) -> State {
        [self.x, self.v, self.theta, self.omega].into()
    }

    #[inline(always)]
    fn set_state(&mut self, state: State) {
        [self.x, self.v, self.theta, self.omega] = state.into();
    }

    #[inline(always)]
    fn advance(&mut self, step: f64) -> Result<(), ModelError> {
        let mut state = self.state();
        let u = Force { value: self.u, slope: self.u_slope };
        match &mut self.selected {
            Selected::TransferFunction(plant) => {
                for k in 0..whole_samples(step, self.ts)? {
                    let held = u.value + u.slope * f64::from(k) * self.ts;
                    state.theta = plant.advance(held);
                }
            }
            Selected::Linear(plant) => plant.advance(&mut state, u, step),
            Selected::Nonlinear => return self.integrate(u, step),
        }
        self.set_state(state);
        Ok(())
    }

    /// Not inlined, so that the steps of the other models need no memory for it.
    #[inline(never)]
    fn integrate(&mut self, u: Force, step: f64) -> Result<(), ModelError> {
        let mut state = self.state();
        nonlinear::advance(&self.parameters, &mut state, u, step)
            .map_err(|failure| self.too_fast(failure))?;
        self.set_state(state);
        Ok(())
    }

    /// The derivatives of the state's derivative.
    fn jacobian(&self) -> Jacobian {
        match &self.selected {
            Selected::TransferFunction(_) => Jacobian::default(),
            Selected::Linear(plant) => plant.jacobian(),
            Selected::Nonlinear => nonlinear::jacobian(&self.parameters, &self.state(), self.u),
        }
    }

    /// Reports a motion that is too fast, with the values at the start of the step.
    fn too_fast(&self, failure: nonlinear::StepFailure) -> ModelError {
        let (theta, omega, u) = (self.theta, self.omega, self.u);
        ModelError::new(format_args!(
            "{failure}; the step started at u = {u:?} N, theta = {theta:?} rad, omega = {omega:?} rad/s"
        ))
    }
}

/// The step as a number of sample times `ts`, with a tolerance of a millionth of `ts`.
fn whole_samples(step: f64, ts: f64) -> Result<u32, ModelError> {
    let samples = (step / ts).round();
    if (step / ts - samples).abs() > 1e-6 {
        return Err(ModelError::refuse(format_args!(
            "with dynamics = transfer_function, the communication step must be a multiple of ts = {ts} s, but it is {step} s"
        )));
    }
    if samples > MAX_SAMPLES {
        return Err(ModelError::discard(format_args!(
            "the communication step of {step} s contains {samples} samples of ts = {ts} s, more than the maximum of {MAX_SAMPLES}"
        )));
    }
    Ok(samples as u32)
}

/// Rounds the step to a multiple of `ts` if it differs only by rounding in the host. Otherwise, a host
/// that computes its step as a difference of times would cause a new matrix exponential at every step.
fn snap(step: f64, ts: f64) -> f64 {
    let nominal = (step / ts).round() * ts;
    if (step - nominal).abs() <= 1e-9 * nominal { nominal } else { step }
}
