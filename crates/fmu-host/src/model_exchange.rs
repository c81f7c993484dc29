//! The functions for model exchange.

use fmu_types::fmi2::{fmi2Boolean, fmi2EventInfo, fmi2False};

use crate::instance::call;
use crate::{Instance, Result};

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
    /// Whether the FMU has written all of them.
    pub is_written: bool,
}

/// The result of a completed integrator step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Completed {
    /// `enterEventMode`
    pub enter_event_mode: bool,
    /// Whether the FMU has written its results.
    pub is_written: bool,
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
        let mut info = fmi2EventInfo {
            newDiscreteStatesNeeded: UNWRITTEN,
            terminateSimulation: UNWRITTEN,
            nominalsOfContinuousStatesChanged: UNWRITTEN,
            valuesOfContinuousStatesChanged: UNWRITTEN,
            nextEventTimeDefined: UNWRITTEN,
            nextEventTime: 0.0,
        };
        call!(self.fmi2NewDiscreteStates(&raw mut info))?;
        let flags = [
            info.newDiscreteStatesNeeded,
            info.terminateSimulation,
            info.valuesOfContinuousStatesChanged,
            info.nextEventTimeDefined,
        ];
        let [again, terminate, states_changed, has_next_event] = flags.map(is_true);
        Ok(Update {
            again,
            terminate,
            states_changed,
            next_event: has_next_event.then_some(info.nextEventTime),
            is_written: !flags.contains(&UNWRITTEN),
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

    /// `fmi2CompletedIntegratorStep`
    pub fn completed_integrator_step(&mut self) -> Result<Completed> {
        let (mut event, mut terminate) = (UNWRITTEN, UNWRITTEN);
        call!(self.fmi2CompletedIntegratorStep(1, &raw mut event, &raw mut terminate))?;
        Ok(Completed {
            enter_event_mode: is_true(event),
            is_written: event != UNWRITTEN && terminate != UNWRITTEN,
        })
    }
}

/// A result that the FMU has not written, which counts as false.
const UNWRITTEN: fmi2Boolean = -1;

fn is_true(value: fmi2Boolean) -> bool {
    value != fmi2False && value != UNWRITTEN
}
