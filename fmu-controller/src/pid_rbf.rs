//! PID-RBF (23), (24) as an FMU.

use fmu_export::unit::{
    NEWTON, NEWTON_PER_RADIAN, NEWTON_PER_RADIAN_SECOND, NEWTON_SECOND_PER_RADIAN, RADIAN, SECOND,
};
use fmu_export::{Model, ModelError, Variable, finite};
use pendulum_control::SampleClock;
use serde::{Deserialize, Serialize};

use crate::rows::{pid_rows, rbf_rows};

/// Sampled PID-RBF: a PID and a network that learns its control.
#[derive(Default, Clone, Serialize, Deserialize)]
pub struct PidRbf {
    r: f64,
    y: f64,
    d: f64,
    law: pendulum_control::PidRbf<4>,
    w0: [f64; 4],
    clock: SampleClock,
}

type Row = Variable<PidRbf>;

impl Model for PidRbf {
    const NAME: &'static str = "PidRbf";
    const DESCRIPTION: &'static str =
        "Sampled PID controller with an RBF network that learns its control while it runs";
    const VARIABLES: &'static [Row] = rbf_rows!(Row, [law], []);

    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        self.law.network.reset(self.w0);
        self.clock = SampleClock::new(start_time, self.law.pid.ts);
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        for _ in 0..self.clock.due(time, step).map_err(ModelError::discard)? {
            self.law.sample(self.r, self.y, self.d);
        }
        finite_law(&self.law)
    }
}

/// Checks that the outputs of a controller with a network are finite.
pub(crate) fn finite_law(law: &pendulum_control::PidRbf<4>) -> Result<(), ModelError> {
    let [w1, w2, w3, w4] = law.network.weights;
    finite!(
        "e": law.pid.e,
        "u_p": law.pid.u_p,
        "u_n": law.u_n,
        "rbf.w[1]": w1,
        "rbf.w[2]": w2,
        "rbf.w[3]": w3,
        "rbf.w[4]": w4,
    )
}
