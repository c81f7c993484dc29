//! IPID-RBF (28), (29) as an FMU.

use fmu_export::unit::{
    NEWTON, NEWTON_PER_RADIAN, NEWTON_PER_RADIAN_SECOND, NEWTON_SECOND_PER_RADIAN, RADIAN, SECOND,
};
use fmu_export::{Enumeration, Model, ModelError, Variable};
use pendulum_control::{SampleClock, Target};
use serde::{Deserialize, Serialize};

use crate::pid_rbf::finite_law;
use crate::rows::{pid_rows, rbf_rows};

/// Sampled IPID-RBF: a PID with a leaky sum, and a network that does the integration.
#[derive(Default, Clone, Serialize, Deserialize)]
pub struct IpidRbf {
    r: f64,
    y: f64,
    d: f64,
    u_supervisor: f64,
    controller: pendulum_control::IpidRbf<4>,
    target: i32,
    w0: [f64; 4],
    clock: SampleClock,
}

const OWN: i32 = 1;
const TARGET: Enumeration = Enumeration {
    name: "Target",
    description: "What the network learns",
    items: &[
        ("own", "the controller's own force (29)"),
        (
            "supervisor",
            "the force of a PID-RBF loop that runs beside, read from u_supervisor",
        ),
    ],
};

type Row = Variable<IpidRbf>;

impl Model for IpidRbf {
    const NAME: &'static str = "IpidRbf";
    const DESCRIPTION: &'static str =
        "Sampled PID controller with a leaking integral, and an RBF network that integrates for it";
    const VARIABLES: &'static [Row] = rbf_rows!(Row, [controller.law], [
        Row::input("u_supervisor", |m| &mut m.u_supervisor)
            .unit(NEWTON)
            .about("force of the supervising loop, the network's target if rbf.target is supervisor"),
        Row::choice("rbf.target", &TARGET, OWN, |m| &mut m.target)
            .about("what the network learns"),
    ]);

    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        self.controller.target = match self.target {
            OWN => Target::Own,
            _ => Target::Supervisor,
        };
        self.controller.law.network.reset(self.w0);
        self.clock = SampleClock::new(start_time, self.controller.law.pid.ts);
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        for _ in 0..self.clock.due(time, step).map_err(ModelError::discard)? {
            self.controller
                .sample(self.r, self.y, self.d, self.u_supervisor);
        }
        finite_law(&self.controller.law)
    }
}
