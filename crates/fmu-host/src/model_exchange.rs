//! The functions for model exchange.

use super::instance::call;
use super::{Instance, Result};
use fmu_types::fmi2::{fmi2Boolean, fmi2Component, fmi2EventInfo, fmi2False, fmi2Real};

const TRUE: fmi2Boolean = 1;

/// A function that gives `n` numbers.
macro_rules! numbers {
    ($about:literal, $name:ident, $function:ident) => {
        #[doc = $about]
        pub fn $name(&mut self, n: usize) -> Result<Vec<f64>> {
            let mut values = vec![0.0; n];
            call!(self.$function(values.as_mut_ptr() => *mut fmi2Real, n => usize))?;
            Ok(values)
        }
    };
}

impl Instance<'_> {
    /// `fmi2NewDiscreteStates`: whether it wants to be called again.
    pub fn new_discrete_states(&mut self) -> Result<bool> {
        let mut info = fmi2EventInfo {
            newDiscreteStatesNeeded: fmi2False,
            terminateSimulation: fmi2False,
            nominalsOfContinuousStatesChanged: fmi2False,
            valuesOfContinuousStatesChanged: fmi2False,
            nextEventTimeDefined: fmi2False,
            nextEventTime: 0.0,
        };
        call!(self.fmi2NewDiscreteStates(&raw mut info => *mut fmi2EventInfo))?;
        Ok(info.newDiscreteStatesNeeded != fmi2False)
    }

    /// `fmi2EnterContinuousTimeMode`
    pub fn enter_continuous_time_mode(&mut self) -> Result<()> {
        call!(self.fmi2EnterContinuousTimeMode())
    }

    /// `fmi2EnterEventMode`
    pub fn enter_event_mode(&mut self) -> Result<()> {
        call!(self.fmi2EnterEventMode())
    }

    /// `fmi2SetTime`
    pub fn set_time(&mut self, time: f64) -> Result<()> {
        call!(self.fmi2SetTime(time => fmi2Real))
    }

    numbers!(
        "`fmi2GetContinuousStates`",
        continuous_states,
        fmi2GetContinuousStates
    );
    numbers!("`fmi2GetDerivatives`", derivatives, fmi2GetDerivatives);
    numbers!(
        "`fmi2GetEventIndicators`",
        event_indicators,
        fmi2GetEventIndicators
    );
    numbers!(
        "`fmi2GetNominalsOfContinuousStates`",
        nominals,
        fmi2GetNominalsOfContinuousStates
    );

    /// `fmi2SetContinuousStates`
    pub fn set_continuous_states(&mut self, states: &[f64]) -> Result<()> {
        call!(self.fmi2SetContinuousStates(
            states.as_ptr() => *const fmi2Real,
            states.len() => usize,
        ))
    }

    /// `fmi2CompletedIntegratorStep`: whether event mode is to be entered.
    pub fn completed_integrator_step(&mut self) -> Result<bool> {
        let (mut event, mut terminate) = (fmi2False, fmi2False);
        call!(self.fmi2CompletedIntegratorStep(
            TRUE => fmi2Boolean,
            &raw mut event => *mut fmi2Boolean,
            &raw mut terminate => *mut fmi2Boolean,
        ))?;
        Ok(event != fmi2False)
    }
}
