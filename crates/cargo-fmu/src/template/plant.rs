//! The plant that the controller is tried with.

use fmu_export::prelude::*;

/// DC motor, from the voltage to the speed
#[derive(Model)]
#[model(name = "MyControllerPlant", stop_time = 2, step_size = 0.01)]
pub struct Plant {
    /// voltage
    #[input(unit = "V")]
    pub u: f64,
    /// speed
    #[output(unit = "rad/s")]
    pub y: f64,
    /// speed per voltage
    #[parameter(start = 10, unit = "rad/(V.s)")]
    gain: f64,
    /// time constant
    #[parameter(start = 0.5, min = 1e-6, unit = "s")]
    time_constant: f64,
}

impl Simulate for Plant {
    /// Solves `time_constant dy/dt = gain u - y` exactly for a constant voltage.
    fn step(&mut self, _time: f64, step: f64) -> Result<(), ModelError> {
        let end = self.gain * self.u;
        self.y = end + (self.y - end) * (-step / self.time_constant).exp();
        Ok(())
    }
}
