//! The functions for co-simulation.

use fmu_types::fmi2::{
    fmi2DoStepStatus, fmi2False, fmi2Integer, fmi2LastSuccessfulTime, fmi2PendingStatus,
    fmi2Terminated,
};

use fmu_types::fmi3::fmi3False;

use crate::instance::{call, call_3};
use crate::{Cause, Failure, Instance, Result, Success, Version};

/// The results of a step of FMI 3.0 (FMI 3.0.2, section 4.2.1.2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stepped {
    /// `eventHandlingNeeded`
    pub event_handling_needed: bool,
    /// `terminateSimulation`
    pub terminate: bool,
    /// `earlyReturn`
    pub early_return: bool,
    /// `lastSuccessfulTime` (s)
    pub last_successful_time: f64,
}

impl Instance {
    /// `fmi2DoStep`, `fmi3DoStep`, with `noSetFMUStatePriorToCurrentPoint` true. In FMI 3.0, a step that
    /// ends early or asks to end the simulation has failed.
    #[inline(always)]
    pub fn do_step(&mut self, time: f64, step: f64) -> Result {
        match self.version {
            Version::Fmi2 => call!(self.fmi2DoStep(time, step, 1)),
            Version::Fmi3 => self.step_to_the_end(time, step),
        }
    }

    #[inline(never)]
    fn step_to_the_end(&mut self, time: f64, step: f64) -> Result {
        let (done, stepped) = self.step(time, step, true)?;
        match stepped.terminate | stepped.early_return {
            false => Ok(done),
            true => Err(not_to_the_end(stepped)),
        }
    }

    /// `fmi3DoStep`; the flag is `noSetFMUStatePriorToCurrentPoint`.
    #[inline]
    pub fn step(&mut self, time: f64, step: f64, no_set_state: bool) -> Result<(Success, Stepped)> {
        let (mut event, mut terminate, mut early) = (fmi3False, fmi3False, fmi3False);
        let mut last = time;
        let done = call_3!(self.fmi3DoStep(
            time,
            step,
            no_set_state.into(),
            &raw mut event,
            &raw mut terminate,
            &raw mut early,
            &raw mut last,
        ))?;
        let stepped = Stepped {
            event_handling_needed: event != fmi3False,
            terminate: terminate != fmi3False,
            early_return: early != fmi3False,
            last_successful_time: last,
        };
        Ok((done, stepped))
    }

    /// `fmi3EnterStepMode`
    pub fn enter_step_mode(&mut self) -> Result {
        call_3!(self.fmi3EnterStepMode())
    }

    /// `fmi2GetBooleanStatus` of `fmi2Terminated`: whether the FMU has ended the simulation.
    pub fn is_terminated(&mut self) -> Result<bool> {
        let mut terminated = fmi2False;
        call!(self.fmi2GetBooleanStatus(fmi2Terminated, &raw mut terminated))?;
        Ok(terminated != fmi2False)
    }

    /// `fmi2GetRealStatus` of `fmi2LastSuccessfulTime`.
    pub fn last_successful_time(&mut self) -> Result<f64> {
        let mut time = 0.0;
        call!(self.fmi2GetRealStatus(fmi2LastSuccessfulTime, &raw mut time))?;
        Ok(time)
    }

    /// `fmi2GetStatus` of `fmi2DoStepStatus` and `fmi2GetStringStatus` of `fmi2PendingStatus`, which are
    /// for asynchronous steps.
    pub fn pending_status(&mut self) -> Result {
        let (mut status, mut text) = (0, std::ptr::null());
        call!(self.fmi2GetStatus(fmi2DoStepStatus, &raw mut status))?;
        call!(self.fmi2GetStringStatus(fmi2PendingStatus, &raw mut text))
    }

    /// `fmi2CancelStep`
    pub fn cancel_step(&mut self) -> Result {
        call!(self.fmi2CancelStep())
    }

    /// `fmi2SetRealInputDerivatives`: the first derivative of each input.
    pub fn set_input_derivatives(&mut self, references: &[u32], values: &[f64]) -> Result {
        let n = references.len().min(values.len());
        let orders: Vec<fmi2Integer> = vec![1; n];
        call!(self.fmi2SetRealInputDerivatives(
            references.as_ptr(),
            n,
            orders.as_ptr(),
            values.as_ptr(),
        ))
    }

    /// `fmi2GetRealOutputDerivatives`, `fmi3GetOutputDerivatives`: the first derivative of each output,
    /// which is a scalar.
    pub fn output_derivatives(&mut self, references: &[u32]) -> Result<Vec<f64>> {
        let n = references.len();
        let (orders, mut values) = (vec![1; n], vec![0.0; n]);
        let (references, orders, pointer) =
            (references.as_ptr(), orders.as_ptr(), values.as_mut_ptr());
        match self.version {
            Version::Fmi2 => {
                call!(self.fmi2GetRealOutputDerivatives(references, n, orders, pointer))?
            }
            Version::Fmi3 => {
                call_3!(self.fmi3GetOutputDerivatives(references, n, orders, pointer, n))?
            }
        };
        Ok(values)
    }
}

#[cold]
fn not_to_the_end(stepped: Stepped) -> Failure {
    let cause = match stepped.terminate {
        true => Cause::Terminated,
        false => Cause::ReturnedEarly(stepped.last_successful_time),
    };
    Failure::new("fmi3DoStep", cause)
}
