//! The functions for co-simulation.

use super::instance::call;
use super::{Instance, Result};
use fmu_types::fmi2::{fmi2Boolean, fmi2Component, fmi2Integer, fmi2Real, fmi2ValueReference};

const TRUE: fmi2Boolean = 1;

impl Instance<'_> {
    /// `fmi2DoStep`
    pub fn do_step(&mut self, time: f64, step: f64) -> Result<()> {
        call!(self.fmi2DoStep(time => fmi2Real, step => fmi2Real, TRUE => fmi2Boolean))
    }

    /// `fmi2SetRealInputDerivatives`: the first derivative of each input.
    pub fn set_input_derivatives(&mut self, references: &[u32], values: &[f64]) -> Result<()> {
        let orders: Vec<fmi2Integer> = vec![1; references.len()];
        call!(self.fmi2SetRealInputDerivatives(
            references.as_ptr() => *const fmi2ValueReference,
            references.len().min(values.len()) => usize,
            orders.as_ptr() => *const fmi2Integer,
            values.as_ptr() => *const fmi2Real,
        ))
    }

    /// `fmi2GetRealOutputDerivatives`: the first derivative of each output.
    pub fn output_derivatives(&mut self, references: &[u32]) -> Result<Vec<f64>> {
        let orders: Vec<fmi2Integer> = vec![1; references.len()];
        let mut values = vec![0.0; references.len()];
        call!(self.fmi2GetRealOutputDerivatives(
            references.as_ptr() => *const fmi2ValueReference,
            references.len() => usize,
            orders.as_ptr() => *const fmi2Integer,
            values.as_mut_ptr() => *mut fmi2Real,
        ))?;
        Ok(values)
    }
}
