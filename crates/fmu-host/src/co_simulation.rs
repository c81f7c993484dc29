//! The functions for co-simulation.

use fmu_types::fmi2::{
    fmi2DoStepStatus, fmi2False, fmi2Integer, fmi2LastSuccessfulTime, fmi2PendingStatus,
    fmi2Terminated,
};

use crate::instance::call;
use crate::{Instance, Result};

impl Instance {
    /// `fmi2DoStep`, with `noSetFMUStatePriorToCurrentPoint` true.
    #[inline]
    pub fn do_step(&mut self, time: f64, step: f64) -> Result {
        call!(self.fmi2DoStep(time, step, 1))
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

    /// `fmi2GetRealOutputDerivatives`: the first derivative of each output.
    pub fn output_derivatives(&mut self, references: &[u32]) -> Result<Vec<f64>> {
        let n = references.len();
        let (orders, mut values) = (vec![1; n], vec![0.0; n]);
        call!(self.fmi2GetRealOutputDerivatives(
            references.as_ptr(),
            n,
            orders.as_ptr(),
            values.as_mut_ptr(),
        ))?;
        Ok(values)
    }
}
