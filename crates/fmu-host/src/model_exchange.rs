//! The functions for model exchange.

use fmu_types::fmi2::{fmi2EventInfo, fmi2False};

use crate::instance::call;
use crate::{Instance, Result};

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
    /// `fmi2NewDiscreteStates`; returns `newDiscreteStatesNeeded`.
    pub fn new_discrete_states(&mut self) -> Result<bool> {
        let mut info = fmi2EventInfo {
            newDiscreteStatesNeeded: fmi2False,
            terminateSimulation: fmi2False,
            nominalsOfContinuousStatesChanged: fmi2False,
            valuesOfContinuousStatesChanged: fmi2False,
            nextEventTimeDefined: fmi2False,
            nextEventTime: 0.0,
        };
        call!(self.fmi2NewDiscreteStates(&raw mut info))?;
        Ok(info.newDiscreteStatesNeeded != fmi2False)
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
        let (mut event, mut terminate) = (fmi2False, fmi2False);
        call!(self.fmi2CompletedIntegratorStep(1, &raw mut event, &raw mut terminate))?;
        Ok(event != fmi2False)
    }
}
