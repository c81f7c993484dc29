//! The PID controller (20) as an FMU.

use fmu_export::prelude::*;

use crate::signals::Signals;

/// Sampled PID controller of the pendulum's angle
#[derive(Model)]
#[model(sample_time = self.law.ts)]
pub struct Pid {
    #[nested(flatten)]
    signals: Signals,
    #[nested(flatten)]
    law: pendulum_control::Pid,
}

impl Simulate for Pid {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        let Signals { r, y, d } = self.signals;
        self.law.sample(r, y, d);
        Ok(())
    }
}
