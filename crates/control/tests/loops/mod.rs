//! The sampled closed loop of section 4, put together from the parts of the library.
#![allow(dead_code, reason = "each test file uses its part")]

use control::pid::{Gains, Integral};
use control::plant::{Linear, Parameters, State};
use control::{IpidRbf, Pid, PidRbf, Rbf, Target, signal};

pub const TS: f64 = 0.001;

/// Set-points of section 4.
#[derive(Clone, Copy, Debug)]
pub enum SetPoint {
    Step,
    Sine,
    Square,
}

impl SetPoint {
    pub fn at(self, time: f64) -> f64 {
        match self {
            Self::Step => 1.0,
            Self::Sine => signal::sine(0.2, time),
            Self::Square => signal::square(0.1, time),
        }
    }
}

/// The PID with the settings of section 4.
pub fn pid(integral: Integral, previous_sample_terms: bool) -> Pid {
    let mut pid = Pid::new(integral);
    pid.gains = Gains {
        kp: 300.0,
        ki: 500.0,
        kd: 100.0,
    };
    pid.ts = TS;
    pid.u_max = 100.0;
    pid.previous_sample_terms = previous_sample_terms;
    pid
}

/// The network with the settings of section 4 and the initial weights `w0`.
pub fn network(w0: [f64; 4]) -> Rbf<4> {
    let mut network = Rbf::default();
    network.centres = [-2.0, -1.0, 1.0, 2.0];
    network.widths = [0.5; 4];
    network.eta = 0.3;
    network.alpha = 0.05;
    network.reset(w0);
    network
}

pub fn pid_rbf(previous_sample_terms: bool, w0: [f64; 4]) -> PidRbf<4> {
    PidRbf {
        pid: pid(Integral::Sum, previous_sample_terms),
        network: network(w0),
        ..PidRbf::default()
    }
}

pub fn ipid_rbf(target: Target, w0: [f64; 4]) -> IpidRbf<4> {
    let mut controller = IpidRbf::default();
    controller.law = PidRbf {
        pid: pid(Integral::Leaky, false),
        network: network(w0),
        ..controller.law
    };
    controller.target = target;
    controller
}

/// Runs `samples` samples of a plant under `controller`, called with (k, y, d) for u (N), and
/// returns the errors e(1) ... e(samples).
pub fn run(
    set_point: SetPoint,
    disturbance: f64,
    samples: u32,
    mut controller: impl FnMut(f64, f64, f64) -> f64,
) -> Vec<f64> {
    let mut plant = Linear::new(&Parameters::PAPER);
    let mut state = State::default();
    (1..=samples)
        .map(|k| {
            let time = f64::from(k) * TS;
            let r = set_point.at(time);
            let d = disturbance * signal::pulse(5.0, 0.5, time);
            let e = r - (state.theta + d);
            let u = controller(r, state.theta, d);
            plant.advance(&mut state, u, TS);
            e
        })
        .collect()
}
