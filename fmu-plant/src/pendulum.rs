//! The three models of the pendulum behind one interface.

use fmu_export::unit::{
    KILOGRAM, KILOGRAM_METRE_SQUARED, METRE, METRE_PER_SECOND, METRE_PER_SECOND_SQUARED, NEWTON,
    NEWTON_SECOND_PER_METRE, RADIAN, RADIAN_PER_SECOND, SECOND,
};
use fmu_export::{Enumeration, Model, ModelError, Variable, finite};
use pendulum_control::clock::MAX_SAMPLES;
use pendulum_control::plant::{Force, Linear, Parameters, State, TransferFunction, nonlinear};
use serde::{Deserialize, Serialize};

/// Cart with inverted pendulum, driven by the force `u`, which is held over a communication step.
#[derive(Default, Clone, Serialize, Deserialize)]
pub struct Pendulum {
    u: Force,
    /// The last step, for the derivatives of its result.
    last: Option<Step>,
    state: State,
    start: State,
    parameters: Parameters,
    ts: f64,
    model: i32,
    dynamics: Dynamics,
}

/// A step that was taken.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Step {
    from: State,
    u: Force,
    step: f64,
}

/// The selected model of the plant, created at initialization.
#[derive(Default, Clone, Serialize, Deserialize)]
enum Dynamics {
    TransferFunction(TransferFunction),
    Linear(Box<Linear>),
    #[default]
    Nonlinear,
}

const TRANSFER_FUNCTION: i32 = 1;
const LINEAR: i32 = 2;
const FORM: Enumeration = Enumeration {
    name: "PlantModel",
    description: "Form of the plant",
    items: &[
        (
            "transfer_function",
            "difference equation (41) at the sample time ts; theta only",
        ),
        ("linear", "linear state space (9), exact for any step"),
        (
            "nonlinear",
            "equations (7), (8), integrated with error control",
        ),
    ],
};

type Row = Variable<Pendulum>;

impl Model for Pendulum {
    const NAME: &'static str = "Pendulum";
    const DESCRIPTION: &'static str = "Cart with an inverted pendulum";
    const VARIABLES: &'static [Row] = &[
        Row::input("u", |m| &mut m.u.value)
            .input_derivative(|m| &mut m.u.slope)
            .unit(NEWTON)
            .about("force on the cart"),
        Row::output("theta", |m| &mut m.state.theta)
            .directional_derivatives(&[("u", |m| m.derivative_by_force().theta)])
            .unit(RADIAN)
            .initially_from(&["theta0"])
            .about("angle of the pendulum from the upright"),
        Row::output("omega", |m| &mut m.state.omega)
            .directional_derivatives(&[("u", |m| m.derivative_by_force().omega)])
            .unit(RADIAN_PER_SECOND)
            .initially_from(&["omega0", "model"])
            .about("angular velocity of the pendulum"),
        Row::output("x", |m| &mut m.state.x)
            .directional_derivatives(&[("u", |m| m.derivative_by_force().x)])
            .unit(METRE)
            .initially_from(&["x0", "model"])
            .about("position of the cart"),
        Row::output("v", |m| &mut m.state.v)
            .directional_derivatives(&[("u", |m| m.derivative_by_force().v)])
            .unit(METRE_PER_SECOND)
            .initially_from(&["v0", "model"])
            .about("velocity of the cart"),
        Row::fixed("M", Parameters::PAPER.M, |m| &mut m.parameters.M)
            .unit(KILOGRAM)
            .at_least(1e-6)
            .at_most(1e6)
            .about("mass of the cart"),
        Row::fixed("m", Parameters::PAPER.m, |m| &mut m.parameters.m)
            .unit(KILOGRAM)
            .at_least(1e-6)
            .at_most(1e6)
            .about("mass of the pendulum"),
        Row::fixed("l", Parameters::PAPER.l, |m| &mut m.parameters.l)
            .unit(METRE)
            .at_least(1e-3)
            .at_most(1e3)
            .about("distance from the pivot to the pendulum's centre of mass"),
        Row::fixed("g", Parameters::PAPER.g, |m| &mut m.parameters.g)
            .unit(METRE_PER_SECOND_SQUARED)
            .at_least(0.0)
            .at_most(1e3)
            .about("gravitational acceleration"),
        Row::fixed("I", Parameters::PAPER.I, |m| &mut m.parameters.I)
            .unit(KILOGRAM_METRE_SQUARED)
            .at_least(0.0)
            .at_most(1e6)
            .about("inertia of the pendulum about its centre of mass"),
        Row::fixed("b", Parameters::PAPER.b, |m| &mut m.parameters.b)
            .unit(NEWTON_SECOND_PER_METRE)
            .at_least(0.0)
            .at_most(1e6)
            .about("friction of the cart"),
        Row::fixed("theta0", 0.0, |m| &mut m.start.theta)
            .unit(RADIAN)
            .at_least(-1e3)
            .at_most(1e3)
            .about("angle at the start"),
        Row::fixed("omega0", 0.0, |m| &mut m.start.omega)
            .unit(RADIAN_PER_SECOND)
            .at_least(-1e3)
            .at_most(1e3)
            .about("angular velocity at the start"),
        Row::fixed("x0", 0.0, |m| &mut m.start.x)
            .unit(METRE)
            .at_least(-1e6)
            .at_most(1e6)
            .about("position of the cart at the start"),
        Row::fixed("v0", 0.0, |m| &mut m.start.v)
            .unit(METRE_PER_SECOND)
            .at_least(-1e6)
            .at_most(1e6)
            .about("velocity of the cart at the start"),
        Row::fixed("ts", 0.001, |m| &mut m.ts)
            .unit(SECOND)
            .at_least(1e-6)
            .at_most(1.0)
            .about("sample time of the transfer function"),
        Row::choice("model", &FORM, LINEAR, |m| &mut m.model).about("form of the plant"),
    ];

    fn initialize(&mut self, _start_time: f64) -> Result<(), ModelError> {
        self.last = None;
        self.state = self.start;
        self.dynamics = match self.model {
            TRANSFER_FUNCTION => {
                let plant = TransferFunction::new(&self.parameters, self.ts, self.start);
                self.state = State {
                    theta: plant.theta(),
                    ..State::default()
                };
                Dynamics::TransferFunction(plant)
            }
            LINEAR => Dynamics::Linear(Box::new(Linear::new(&self.parameters))),
            _ => Dynamics::Nonlinear,
        };
        Ok(())
    }

    fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
        let last = Step {
            from: self.state,
            u: self.u,
            step: match &self.last {
                Some(last) if last.step == step => step, // already snapped if needed
                _ => snap(step, self.ts),
            },
        };
        self.advance(&last)?;
        self.last = Some(last);
        let State { x, v, theta, omega } = self.state;
        finite!("theta": theta, "omega": omega, "x": x, "v": v)
    }
}

impl Pendulum {
    fn advance(&mut self, &Step { u, step, .. }: &Step) -> Result<(), ModelError> {
        match &mut self.dynamics {
            Dynamics::TransferFunction(plant) => {
                for k in 0..whole_samples(step, self.ts)? {
                    let held = u.value + u.slope * f64::from(k) * self.ts;
                    self.state.theta = plant.advance(held);
                }
            }
            Dynamics::Linear(plant) => plant.advance(&mut self.state, u, step),
            Dynamics::Nonlinear => {
                nonlinear::advance(&self.parameters, &mut self.state, u, step)
                    .map_err(|failure| self.too_fast(failure))?;
            }
        }
        Ok(())
    }

    /// Reports a motion that is too fast, with the values at the start of the step.
    fn too_fast(&self, failure: nonlinear::StepFailure) -> ModelError {
        let (State { theta, omega, .. }, u) = (self.state, self.u.value);
        ModelError::new(format_args!(
            "{failure}; the step started at u = {u:?} N, theta = {theta:?} rad, omega = {omega:?} rad/s"
        ))
    }

    /// The derivative of the state with respect to the force held over the last step, per N; zero
    /// before the first step.
    fn derivative_by_force(&self) -> State {
        let Some(Step { from, u, step }) = &self.last else {
            return State::default();
        };
        match &self.dynamics {
            Dynamics::TransferFunction(plant) => State {
                theta: plant.sensitivity(whole_samples(*step, self.ts).unwrap_or(0)),
                ..State::default()
            },
            Dynamics::Linear(plant) => plant.sensitivity(*step),
            // The step succeeded before, so it succeeds again.
            Dynamics::Nonlinear => {
                nonlinear::sensitivity(&self.parameters, from, *u, *step).unwrap_or_default()
            }
        }
    }
}

/// The step as a number of sample times `ts`, with a tolerance of a millionth of `ts`.
fn whole_samples(step: f64, ts: f64) -> Result<u32, ModelError> {
    let samples = (step / ts).round();
    if (step / ts - samples).abs() > 1e-6 {
        return Err(ModelError::refuse(format_args!(
            "with the model transfer_function, the communication step must be a multiple of ts = {ts} s, but it is {step} s"
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
    if (step - nominal).abs() <= 1e-9 * nominal {
        nominal
    } else {
        step
    }
}
