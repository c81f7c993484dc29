//! PID-RBF (23), (24) as an FMU.

use fmu_export::prelude::*;

use crate::signals::Signals;

/// Sampled PID controller with an RBF network that learns its control while it runs
#[derive(Model)]
#[model(sample_time = self.law.pid.ts)]
pub struct PidRbf {
    #[nested(flatten)]
    signals: Signals,
    #[nested(flatten)]
    law: pendulum_control::PidRbf<16>,
}

impl Simulate for PidRbf {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.law.network.reset();
        Ok(())
    }

    fn reconfigure(&mut self) -> Result<(), ModelError> {
        self.law.network.resize();
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        let Signals { r, y, d } = self.signals;
        self.law.sample(r, y, d);
        Ok(())
    }
}
