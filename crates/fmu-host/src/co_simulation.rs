//! The functions for co-simulation.

use fmu_types::fmi2::fmi2Integer;

use crate::instance::call;
use crate::{Instance, Result};

impl Instance {
    /// `fmi2DoStep`, with `noSetFMUStatePriorToCurrentPoint` true.
    #[inline]
    pub fn do_step(&mut self, time: f64, step: f64) -> Result {
        call!(self.fmi2DoStep(time, step, 1))
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
