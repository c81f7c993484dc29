//! The functions for model exchange.

use fmu_types::fmi2::{fmi2Boolean, fmi2EventInfo, fmi2False};

use crate::instance::call;
use crate::{Cause, Failure, Instance, Result};

/// The result of an update of discrete states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Update {
    /// `newDiscreteStatesNeeded`
    pub again: bool,
    /// `terminateSimulation`
    pub terminate: bool,
    /// `valuesOfContinuousStatesChanged`
    pub states_changed: bool,
    /// `nextEventTime`, if it is defined.
    pub next_event: Option<f64>,
}

/// Defines functions that return `n` numbers.
macro_rules! numbers {
    ($($name:ident $function:ident;)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            pub fn $name(&mut self, n: usize) -> Result<Vec<f64>> {
                let mut values = vec![0.0; n];
                call!(self.$function(values.as_mut_ptr(), n))?;
                Ok(values)
            }
        )*
    };
}

impl Instance {
    /// `fmi2NewDiscreteStates`
    pub fn new_discrete_states(&mut self) -> Result<Update> {
        const NAME: &str = "fmi2NewDiscreteStates";
        let mut info = fmi2EventInfo {
            newDiscreteStatesNeeded: UNWRITTEN,
            terminateSimulation: UNWRITTEN,
            nominalsOfContinuousStatesChanged: UNWRITTEN,
            valuesOfContinuousStatesChanged: UNWRITTEN,
            nextEventTimeDefined: UNWRITTEN,
            nextEventTime: 0.0,
        };
        call!(self.fmi2NewDiscreteStates(&raw mut info))?;
        Ok(Update {
            again: written(NAME, info.newDiscreteStatesNeeded)?,
            terminate: written(NAME, info.terminateSimulation)?,
            states_changed: written(NAME, info.valuesOfContinuousStatesChanged)?,
            next_event: written(NAME, info.nextEventTimeDefined)?.then_some(info.nextEventTime),
        })
    }

    /// `fmi2EnterContinuousTimeMode`
    pub fn enter_continuous_time_mode(&mut self) -> Result {
        call!(self.fmi2EnterContinuousTimeMode())
    }

    /// `fmi2EnterEventMode`
    pub fn enter_event_mode(&mut self) -> Result {
        call!(self.fmi2EnterEventMode())
    }

    /// `fmi2SetTime`
    pub fn set_time(&mut self, time: f64) -> Result {
        call!(self.fmi2SetTime(time))
    }

    numbers! {
        continuous_states fmi2GetContinuousStates;
        derivatives fmi2GetDerivatives;
        event_indicators fmi2GetEventIndicators;
        nominals fmi2GetNominalsOfContinuousStates;
    }

    /// `fmi2SetContinuousStates`
    pub fn set_continuous_states(&mut self, states: &[f64]) -> Result {
        call!(self.fmi2SetContinuousStates(states.as_ptr(), states.len()))
    }

    /// `fmi2CompletedIntegratorStep`; returns `enterEventMode`.
    pub fn completed_integrator_step(&mut self) -> Result<bool> {
        const NAME: &str = "fmi2CompletedIntegratorStep";
        let (mut event, mut terminate) = (UNWRITTEN, UNWRITTEN);
        call!(self.fmi2CompletedIntegratorStep(1, &raw mut event, &raw mut terminate))?;
        written(NAME, terminate)?;
        written(NAME, event)
    }
}

/// A result that the FMU has not written.
const UNWRITTEN: fmi2Boolean = -1;

fn written(function: &'static str, value: fmi2Boolean) -> Result<bool> {
    match value {
        UNWRITTEN => Err(Failure::new(
            function,
            Cause::Broke("did not write its results"),
        )),
        value => Ok(value != fmi2False),
    }
}
