//! The sampled closed loop of section 4 and its settings, to run without an FMU.
//!
//! ```
//! use pendulum_control::closed_loop::{ClosedLoop, Order, SetPoint, pid};
//! use pendulum_control::pid::Integral;
//!
//! let mut pid = pid(Integral::Sum, true);
//! let mut closed_loop = ClosedLoop::new(Order::Sequential);
//! for sample in closed_loop.run(SetPoint::Step, 0.0, |r, y, d| pid.sample(r, y, d)).take(20_000) {
//!     assert!(sample.u.abs() <= 100.0);
//! }
//! assert!((closed_loop.theta() - 1.0).abs() < 3e-3, "the loop has settled");
//! ```

use crate::pid::{Gains, Integral};
use crate::plant::{Linear, Parameters, State};
use crate::{IpidRbf, Pid, PidRbf, Rbf, Target, signal};

/// Sample time and communication step (s).
pub const TS: f64 = 0.001;

/// The set-points of section 4.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SetPoint {
    /// 1 rad
    Step,
    /// sin(2 pi 0.2 t)
    Sine,
    /// sign(sin(2 pi 0.1 t))
    Square,
}

impl SetPoint {
    /// The set-point (rad) at `time` (s).
    pub fn at(self, time: f64) -> f64 {
        match self {
            Self::Step => 1.0,
            Self::Sine => signal::sine(0.2, time),
            Self::Square => signal::square(0.1, time),
        }
    }
}

/// When the force of a sample reaches the plant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Immediately: the controller steps before the plant (Gauss-Seidel).
    Sequential,
    /// One sample later: both step from the same values (Jacobi).
    Parallel,
}

/// The result of one sample of the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// The error e = r - (y + d) (rad).
    pub e: f64,
    /// The controller's force (N).
    pub u: f64,
}

/// The linear plant with the parameters of the paper, initially at rest, under any controller.
#[derive(Debug, Clone)]
pub struct ClosedLoop {
    plant: Linear,
    state: State,
    order: Order,
    u: f64,
}

impl ClosedLoop {
    /// The loop at rest.
    pub fn new(order: Order) -> Self {
        Self { plant: Linear::new(&Parameters::PAPER), state: State::default(), order, u: 0.0 }
    }

    /// The angle of the pendulum (rad).
    pub fn theta(&self) -> f64 {
        self.state.theta
    }

    /// Takes one sample: the controller computes a force (N) from the set-point `r`, the angle and its
    /// disturbance `d` (rad), and the plant advances by [`TS`] under a constant force.
    pub fn sample(
        &mut self,
        r: f64,
        d: f64,
        controller: impl FnOnce(f64, f64, f64) -> f64,
    ) -> Sample {
        let y = self.state.theta;
        let before = core::mem::replace(&mut self.u, controller(r, y, d));
        let applied = match self.order {
            Order::Sequential => self.u,
            Order::Parallel => before,
        };
        self.plant.advance(&mut self.state, applied, TS);
        Sample { e: r - (y + d), u: self.u }
    }

    /// The samples k = 1, 2, ... of section 4, with a `disturbance` (rad) added to the measured angle
    /// for 5 s <= t < 5.5 s.
    pub fn run(
        &mut self,
        set_point: SetPoint,
        disturbance: f64,
        mut controller: impl FnMut(f64, f64, f64) -> f64,
    ) -> impl Iterator<Item = Sample> {
        let mut time = TS;
        (0u32..).map(move |k| {
            let (r, d) = (set_point.at(time), disturbance * signal::pulse(5.0, 0.5, time));
            // Bit-identical to the time of a source that steps from k ts to k ts + ts.
            time = (TS + f64::from(k) * TS) + TS;
            self.sample(r, d, &mut controller)
        })
    }
}

/// The PID with the settings of section 4.
pub fn pid(integral: Integral, previous_sample_terms: bool) -> Pid {
    let mut pid = Pid::new(integral);
    pid.gains = Gains { kp: 300.0, ki: 500.0, kd: 100.0 };
    pid.ts = TS;
    pid.u_max = 100.0;
    pid.previous_sample_terms = previous_sample_terms;
    pid
}

/// The network with the settings of section 4 and the initial weights `w0` (N).
pub fn network(w0: [f64; 4]) -> Rbf<4> {
    let mut network = Rbf::default();
    network.centres = [-2.0, -1.0, 1.0, 2.0];
    network.widths = [0.5; 4];
    network.eta = 0.3;
    network.alpha = 0.05;
    network.initial_weights = w0;
    network.reset();
    network
}

/// PID-RBF with the settings of section 4 and the initial weights `w0` (N).
pub fn pid_rbf(previous_sample_terms: bool, w0: [f64; 4]) -> PidRbf<4> {
    PidRbf {
        pid: pid(Integral::Sum, previous_sample_terms),
        network: network(w0),
        ..PidRbf::default()
    }
}

/// IPID-RBF with the settings of section 4 and the initial weights `w0` (N).
pub fn ipid_rbf(target: Target, w0: [f64; 4]) -> IpidRbf<4> {
    let law =
        PidRbf { pid: pid(Integral::Leaky, false), network: network(w0), ..PidRbf::default() };
    IpidRbf { law, target }
}
