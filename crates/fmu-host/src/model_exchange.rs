//! The functions for model exchange.

use fmu_types::fmi2::{fmi2Boolean, fmi2EventInfo, fmi2False};

use fmu_types::fmi3::{fmi3Boolean, fmi3False};

use crate::instance::{call, call_3, call_either};
use crate::{Instance, Result, Version};

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
    ($($name:ident $in_2:ident $in_3:ident;)*) => {
        $(
            #[doc = concat!("`", stringify!($in_2), "`, `", stringify!($in_3), "`")]
            pub fn $name(&mut self, n: usize) -> Result<Vec<f64>> {
                let mut values = vec![0.0; n];
                call_either!(self.$in_2 / $in_3(values.as_mut_ptr(), n))?;
                Ok(values)
            }
        )*
    };
}

impl Instance {
    /// `fmi2NewDiscreteStates`, `fmi3UpdateDiscreteStates`
    pub fn new_discrete_states(&mut self) -> Result<Update> {
        match self.version {
            Version::Fmi2 => self.new_discrete_states_2(),
            Version::Fmi3 => self.update_discrete_states(),
        }
    }

    fn update_discrete_states(&mut self) -> Result<Update> {
        let [
            mut again,
            mut terminate,
            mut nominals,
            mut states,
            mut has_next,
        ] = [UNWRITTEN_3; 5];
        let mut next = 0.0;
        call_3!(self.fmi3UpdateDiscreteStates(
            &raw mut again,
            &raw mut terminate,
            &raw mut nominals,
            &raw mut states,
            &raw mut has_next,
            &raw mut next,
        ))?;
        Ok(Update {
            again: is_true_3(again),
            terminate: is_true_3(terminate),
            states_changed: is_true_3(states),
            next_event: is_true_3(has_next).then_some(next),
            is_written: ![again, terminate, states, has_next].contains(&UNWRITTEN_3),
        })
    }

    fn new_discrete_states_2(&mut self) -> Result<Update> {
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

    /// `fmi2EnterContinuousTimeMode`, `fmi3EnterContinuousTimeMode`
    pub fn enter_continuous_time_mode(&mut self) -> Result {
        call_either!(self.fmi2EnterContinuousTimeMode / fmi3EnterContinuousTimeMode())
    }

    /// `fmi2EnterEventMode`, `fmi3EnterEventMode`; in FMI 3.0 also for co-simulation.
    pub fn enter_event_mode(&mut self) -> Result {
        call_either!(self.fmi2EnterEventMode / fmi3EnterEventMode())
    }

    /// `fmi3EvaluateDiscreteStates`
    pub fn evaluate_discrete_states(&mut self) -> Result {
        call_3!(self.fmi3EvaluateDiscreteStates())
    }

    /// `fmi2SetTime`, `fmi3SetTime`
    pub fn set_time(&mut self, time: f64) -> Result {
        call_either!(self.fmi2SetTime / fmi3SetTime(time))
    }

    /// `fmi3GetNumberOfContinuousStates`
    pub fn number_of_continuous_states(&mut self) -> Result<usize> {
        let mut n = 0;
        call_3!(self.fmi3GetNumberOfContinuousStates(&raw mut n))?;
        Ok(n)
    }

    /// `fmi3GetNumberOfEventIndicators`
    pub fn number_of_event_indicators(&mut self) -> Result<usize> {
        let mut n = 0;
        call_3!(self.fmi3GetNumberOfEventIndicators(&raw mut n))?;
        Ok(n)
    }

    numbers! {
        continuous_states fmi2GetContinuousStates fmi3GetContinuousStates;
        derivatives fmi2GetDerivatives fmi3GetContinuousStateDerivatives;
        event_indicators fmi2GetEventIndicators fmi3GetEventIndicators;
        nominals fmi2GetNominalsOfContinuousStates fmi3GetNominalsOfContinuousStates;
    }

    /// `fmi2SetContinuousStates`, `fmi3SetContinuousStates`
    pub fn set_continuous_states(&mut self, states: &[f64]) -> Result {
        let (n, states) = (states.len(), states.as_ptr());
        call_either!(self.fmi2SetContinuousStates / fmi3SetContinuousStates(states, n))
    }

    /// `fmi2CompletedIntegratorStep`, `fmi3CompletedIntegratorStep`
    pub fn completed_integrator_step(&mut self) -> Result<Completed> {
        if self.version == Version::Fmi3 {
            let (mut event, mut terminate) = (UNWRITTEN_3, UNWRITTEN_3);
            call_3!(self.fmi3CompletedIntegratorStep(1, &raw mut event, &raw mut terminate))?;
            return Ok(Completed {
                enter_event_mode: is_true_3(event),
                is_written: event != UNWRITTEN_3 && terminate != UNWRITTEN_3,
            });
        }
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

/// As [`UNWRITTEN`], for FMI 3.0.
const UNWRITTEN_3: fmi3Boolean = 0xff;

fn is_true_3(value: fmi3Boolean) -> bool {
    value != fmi3False && value != UNWRITTEN_3
}

fn is_true(value: fmi2Boolean) -> bool {
    value != fmi2False && value != UNWRITTEN
}
