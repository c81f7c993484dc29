//! IPID-RBF (28), (29) as an FMU.

use fmu_export::prelude::*;

use crate::signals::Signals;

/// Sampled PID controller with a leaking integral, and an RBF network that integrates for it
#[derive(Model)]
#[model(sample_time = self.controller.law.pid.ts)]
pub struct IpidRbf {
    #[nested(flatten)]
    signals: Signals,
    /// Force of the supervising loop, the network's target if rbf.target is supervisor
    #[input(unit = "N")]
    u_supervisor: f64,
    #[nested(flatten)]
    controller: pendulum_control::IpidRbf<16>,
}

impl Simulate for IpidRbf {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.controller.law.network.reset();
        Ok(())
    }

    fn reconfigure(&mut self) -> Result<(), ModelError> {
        self.controller.law.network.resize();
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        let Signals { r, y, d } = self.signals;
        self.controller.sample(r, y, d, self.u_supervisor);
        Ok(())
    }
}
