//! The PID controller (20) as an FMU.

use fmu_export::unit::{
    NEWTON, NEWTON_PER_RADIAN, NEWTON_PER_RADIAN_SECOND, NEWTON_SECOND_PER_RADIAN, RADIAN, SECOND,
};
use fmu_export::{Model, ModelError, Variable, finite};
use pendulum_control::SampleClock;
use serde::{Deserialize, Serialize};

use crate::rows::pid_rows;

/// The sampled PID controller (20).
#[derive(Default, Clone, Serialize, Deserialize)]
pub struct Pid {
    r: f64,
    y: f64,
    d: f64,
    pid: pendulum_control::Pid,
    clock: SampleClock,
}

type Row = Variable<Pid>;

impl Model for Pid {
    const NAME: &'static str = "Pid";
    const DESCRIPTION: &'static str = "Sampled PID controller of the pendulum's angle";
    const VARIABLES: &'static [Row] = pid_rows!(Row, [pid], u = [pid.u], []);

    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        self.clock = SampleClock::new(start_time, self.pid.ts);
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        for _ in 0..self.clock.due(time, step).map_err(ModelError::discard)? {
            self.pid.sample(self.r, self.y, self.d);
        }
        finite!("e": self.pid.e, "u_p": self.pid.u_p)
    }
}
