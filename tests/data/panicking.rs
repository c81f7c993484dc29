//! A model with a bug, as an FMU.

use fmu_export::prelude::*;

/// y = u, and a panic if u is negative
#[derive(Model)]
pub struct Panicking {
    /// what must not be negative
    #[input]
    u: f64,
    /// the same
    #[output]
    y: f64,
}

impl Simulate for Panicking {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        assert!(self.u >= 0.0, "u is {:?}", self.u);
        self.y = self.u;
        Ok(())
    }
}
