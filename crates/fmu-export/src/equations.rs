//! The equations of a model, for hosts that integrate them, and for values that are computed only when a host asks
//! for them.

use dormand_prince::solver;
use fmi_abi::state::State;

use crate::any_model::{AnyModel, SolverVector};
use crate::error::{ModelError, Severity, ensure, refused};
use crate::instance::Instance;
use crate::lifecycle::{InstanceType, Lifecycle};

impl Instance {
    /// Evaluates the equations between steps if the host asks for what is computed only then: derivatives and event
    /// indicators. Otherwise, computes what is not up to date. Returns the model before an evaluation, to which it
    /// is to return: outputs have the values of the last step.
    pub(crate) fn prepare(
        &mut self,
        needs_evaluation: bool,
    ) -> Result<Option<Box<dyn AnyModel>>, ModelError> {
        let Lifecycle { instance_type, state, .. } = self.shared.lifecycle;
        let is_stepped = instance_type != InstanceType::ModelExchange
            && matches!(
                state,
                State::StepMode | State::StepFailed | State::IntermediateUpdate | State::Terminated
            );
        if is_stepped && self.model.info().is_continuous && needs_evaluation {
            return self.evaluate_aside().map(Some);
        }
        self.update()?;
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

    /// Computes what a host may read and is not up to date, before the end of the initialization, in event
    /// mode and in model exchange.
    pub(crate) fn update(&mut self) -> Result<(), ModelError> {
        let Lifecycle { instance_type, state, stale, .. } = self.shared.lifecycle;
        let is_evaluated = match state {
            _ if !stale => return Ok(()),
            State::Initialization => return self.initialize(),
            State::Event | State::ContinuousTime => true,
            State::Terminated => instance_type == InstanceType::ModelExchange,
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
        ensure!(time.is_finite(), "the time is {time:?}; expected a finite number");
        let lifecycle = &mut self.shared.lifecycle;
        lifecycle.stale |= time != lifecycle.time;
        lifecycle.time = time;
        Ok(())
    }

    pub(crate) fn set_continuous_states(&mut self, states: &[f64]) -> Result<(), ModelError> {
        self.check_length(SolverVector::States, states.len())?;
        if let Some(&value) = states.iter().find(|value| !value.is_finite()) {
            return refused!("a state is {value}; expected finite numbers");
        }
        if self.shared.lifecycle.state == State::Event {
            self.warn_once("states are set in event mode");
        }
        self.model.set_states(states);
        self.shared.lifecycle.stale = true;
        Ok(())
    }

    fn get_numbers(&mut self, which: SolverVector, values: &mut [f64]) -> Result<(), ModelError> {
        self.check_length(which, values.len())?;
        if which != SolverVector::Nominals {
            self.update()?;
        }
        self.model.read_vector(which, values);
        Ok(())
    }

    fn check_length(&self, of: SolverVector, found: usize) -> Result<(), ModelError> {
        let expected = self.model.vector_length(of);
        let what = match of {
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
macro_rules! get_numbers {
    ($($name:ident: $which:ident;)*) => {
        impl Instance {
            $(pub(crate) fn $name(&mut self, values: &mut [f64]) -> Result<(), ModelError> {
                self.get_numbers(SolverVector::$which, values)
            })*
        }
    };
}

get_numbers! {
    get_continuous_states: States;
    get_continuous_state_derivatives: Derivatives;
    get_event_indicators: EventIndicators;
    get_nominals_of_continuous_states: Nominals;
}

/// The equations of a model, as the solver sees them.
pub(crate) struct Equations<'a>(pub(crate) &'a mut (dyn AnyModel + 'static));

impl solver::OdeSystem for Equations<'_> {
    type Error = ModelError;

    fn nominal(&self, state: usize) -> f64 {
        self.0.info().states[state].nominal
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
