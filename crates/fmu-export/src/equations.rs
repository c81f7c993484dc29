//! The equations of a model, for hosts that integrate them, and for values that are computed only when a host asks
//! for them.

use fmi_abi::state::State;
use fmu_description::Number;
use ode_methods::solver;

use crate::any_model::{AnyModel, SolverVector};
use crate::error::{ModelError, Severity, ensure, refused};
use crate::instance::Instance;
use crate::lifecycle::Lifecycle;

impl Instance {
    /// Makes values ready to be read. Between steps, evaluates the equations if the host asks for derivatives or event
    /// indicators, and returns the model before, which the caller restores: outputs keep the values of the last step.
    /// Otherwise, brings values up to date.
    pub(crate) fn prepare_values(
        &mut self,
        needs_evaluation: bool,
    ) -> Result<Option<Box<dyn AnyModel>>, ModelError> {
        let Lifecycle { instance_type, state, .. } = self.shared.lifecycle;
        let is_stepped = !instance_type.is_model_exchange()
            && matches!(
                state,
                State::StepMode | State::StepFailed | State::IntermediateUpdate | State::Terminated
            );
        if is_stepped && self.model.info().is_continuous && needs_evaluation {
            return self.evaluate_aside().map(Some);
        }
        self.bring_up_to_date()?;
        Ok(None)
    }

    /// Evaluates the equations between steps, and discards nothing, as only steps are discarded. Returns the
    /// model before.
    pub(crate) fn evaluate_aside(&mut self) -> Result<Box<dyn AnyModel>, ModelError> {
        let saved = self.model.copy();
        match self.evaluate(self.shared.lifecycle.now()) {
            Ok(()) => Ok(saved),
            Err(error) => {
                self.model.assign(saved.as_ref());
                Err(error.not_discarded())
            }
        }
    }

    /// Computes values that are not up to date, before the end of the initialization, in event
    /// mode and in model exchange.
    pub(crate) fn bring_up_to_date(&mut self) -> Result<(), ModelError> {
        let Lifecycle { instance_type, state, stale, .. } = self.shared.lifecycle;
        let is_evaluated = match state {
            _ if !stale => return Ok(()),
            State::Initialization => return self.initialize(),
            State::Event | State::ContinuousTime => true,
            State::Terminated => instance_type.is_model_exchange(),
            _ => false,
        };
        if is_evaluated {
            self.evaluate(self.shared.lifecycle.now())?;
            self.shared.lifecycle.stale = false;
        }
        Ok(())
    }

    /// Computes derivatives, event indicators and outputs from states and inputs.
    fn evaluate(&mut self, time: f64) -> Result<(), ModelError> {
        if self.model.info().is_continuous {
            self.model.behavior_mut().on_evaluate(time)?;
            let checked = self.model.check_equations();
            checked.map_err(|error| error.with_severity(Severity::Discarded))?;
        }
        Ok(())
    }

    /// Sets the time of model exchange.
    pub(crate) fn set_time(&mut self, time: f64) -> Result<(), ModelError> {
        ensure!(time.is_finite(), "the time is {:?}; expected a finite number", Number(time));
        let lifecycle = &mut self.shared.lifecycle;
        lifecycle.stale |= time != lifecycle.time;
        lifecycle.time = time;
        Ok(())
    }

    pub(crate) fn set_continuous_states(&mut self, states: &[f64]) -> Result<(), ModelError> {
        self.check_length(SolverVector::States, states.len())?;
        if let Some(&value) = states.iter().find(|value| !value.is_finite()) {
            return refused!("a state is {}; expected finite numbers", Number(value));
        }
        if self.shared.lifecycle.state == State::Event {
            self.warn_once("states are set in event mode");
        }
        self.model.set_states(states);
        self.shared.lifecycle.stale = true;
        Ok(())
    }

    fn get_vector(&mut self, vector: SolverVector, values: &mut [f64]) -> Result<(), ModelError> {
        self.check_length(vector, values.len())?;
        if vector != SolverVector::Nominals {
            self.bring_up_to_date()?;
        }
        self.model.read_vector(vector, values);
        Ok(())
    }

    fn check_length(&self, vector: SolverVector, found: usize) -> Result<(), ModelError> {
        let expected = self.model.vector_length(vector);
        let what = match vector {
            SolverVector::EventIndicators => "event indicators",
            _ => "continuous states",
        };
        ensure!(
            found == expected,
            "the array has {found} elements; expected {expected}, the number of {what}"
        );
        Ok(())
    }
}

/// Defines methods that get the numbers which a host integrates, or locates events with.
macro_rules! get_vectors {
    ($($name:ident: $which:ident;)*) => {
        impl Instance {
            $(pub(crate) fn $name(&mut self, values: &mut [f64]) -> Result<(), ModelError> {
                self.get_vector(SolverVector::$which, values)
            })*
        }
    };
}

get_vectors! {
    get_continuous_states: States;
    get_continuous_state_derivatives: Derivatives;
    get_event_indicators: EventIndicators;
    get_nominals_of_continuous_states: Nominals;
}

/// The equations of a model, as the solver sees them; the Jacobian is for an `IMPLICIT` method.
pub(crate) struct ModelEquations<'a, const IMPLICIT: bool>(
    pub(crate) &'a mut (dyn AnyModel + 'static),
);

impl<const IMPLICIT: bool> solver::OdeSystem for ModelEquations<'_, IMPLICIT> {
    type Error = ModelError;

    fn nominal(&self, state: usize) -> f64 {
        self.0.nominal(state)
    }

    fn states(&mut self, states: &mut [f64]) -> Result<(), ModelError> {
        self.0.read_vector(SolverVector::States, states);
        Ok(())
    }

    fn evaluate(&mut self, time: f64, states: &[f64]) -> Result<bool, ModelError> {
        self.0.set_states(states);
        self.0.behavior_mut().on_evaluate(time)?;
        Ok(self.0.check_equations().is_ok())
    }

    fn derivatives(&mut self, derivatives: &mut [f64]) {
        self.0.read_vector(SolverVector::Derivatives, derivatives);
    }

    fn directional_derivative(
        &mut self,
        direction: &[f64],
        product: &mut [f64],
    ) -> Result<bool, ModelError> {
        let is_known = IMPLICIT && self.0.info().has_directional_derivatives;
        if is_known {
            self.0.multiply_jacobian(direction, product);
        }
        Ok(is_known)
    }

    fn event_indicator(&mut self, indicator: usize) -> f64 {
        self.0.event_indicator(indicator)
    }

    fn not_finite(&mut self) -> ModelError {
        let checked = self.0.check_equations();
        checked.err().unwrap_or_else(|| ModelError::new("the states became too large"))
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        self.0.behavior_mut().on_event(time)
    }

    fn next_event(&self, time: f64) -> Option<f64> {
        self.0.behavior().on_next_event(time)
    }
}
