use control_blocks::*;
use fmu_export::prelude::*;

/// All blocks of control-blocks with the same input, each by itself
#[derive(Model)]
#[model(sample_time = self.ts, stop_time = 10, step_size = 0.01)]
pub struct Bench {
    /// Input of all blocks
    #[input]
    u: f64,
    /// Second input of the table and the set-point of the controller
    #[input]
    v: f64,
    /// Sample time
    #[parameter(start = 0.01, min = 1e-6, unit = "s")]
    ts: f64,
    /// Output of the controller for the measured value u
    #[output(name = "y.pid")]
    y_pid: f64,
    /// Output of the first-order filter
    #[output(name = "y.first_order")]
    y_first_order: f64,
    /// Output of the second-order filter
    #[output(name = "y.second_order")]
    y_second_order: f64,
    /// Output of the high-pass filter
    #[output(name = "y.high_pass")]
    y_high_pass: f64,
    /// Output of the lead-lag compensator
    #[output(name = "y.lead_lag")]
    y_lead_lag: f64,
    /// Moving average
    #[output(name = "y.average")]
    y_average: f64,
    /// Limited value
    #[output(name = "y.saturation")]
    y_saturation: f64,
    /// Value of limited rate
    #[output(name = "y.rate_limiter")]
    y_rate_limiter: f64,
    /// Distance from the dead zone
    #[output(name = "y.dead_zone")]
    y_dead_zone: f64,
    /// Output of the relay
    #[output(name = "y.hysteresis")]
    y_hysteresis: f64,
    /// Value of the table with one axis
    #[output(name = "y.table1")]
    y_table1: f64,
    /// Value of the table with two axes
    #[output(name = "y.table2")]
    y_table2: f64,
    /// Outputs of the system in state space
    #[output(name = "y.state_space")]
    y_state_space: [f64; 2],
    /// Estimate of the Kalman filter with the input v and the measured value u
    #[output(name = "y.kalman")]
    y_kalman: [f64; 2],
    /// Step
    #[output(name = "y.step")]
    y_step: f64,
    /// Ramp
    #[output(name = "y.ramp")]
    y_ramp: f64,
    /// Sine
    #[output(name = "y.sine")]
    y_sine: f64,
    /// Square wave
    #[output(name = "y.square")]
    y_square: f64,
    /// Chirp
    #[output(name = "y.chirp")]
    y_chirp: f64,
    /// Pseudo-random binary sequence
    #[output(name = "y.prbs")]
    y_prbs: f64,
    #[nested]
    pid: Pid,
    #[nested]
    first_order: FirstOrder,
    #[nested]
    second_order: SecondOrder,
    #[nested]
    high_pass: HighPass,
    #[nested]
    lead_lag: LeadLag,
    #[nested]
    average: MovingAverage<5>,
    #[nested]
    saturation: Saturation,
    #[nested]
    rate_limiter: RateLimiter,
    #[nested]
    dead_zone: DeadZone,
    #[nested]
    hysteresis: Hysteresis,
    #[nested(x(start = [-2, -1, 0.5, 2]), y(start = [4, 1, 0, 3]))]
    table1: Table1<4>,
    #[nested(x(start = [-1, 0, 2]), y(start = [-2, 1]), z(start = [[1, 2], [3, -1], [0.5, 4]]))]
    table2: Table2<3, 2>,
    #[nested(
        a(start = [[0.9, 0.1], [-0.2, 0.8]]),
        b(start = [[0.5], [1]]),
        c(start = [[1, 0], [1, -1]]),
        d(start = [[0], [0.25]])
    )]
    state_space: StateSpace<2, 1, 2>,
    #[nested(
        a(start = [[1, 0.01], [0, 1]]),
        b(start = [[0], [0.01]]),
        c(start = [[1, 0]]),
        q(start = [[1e-4, 0], [0, 1e-2]]),
        r(start = [[0.1]])
    )]
    kalman: Kalman<2, 1, 1>,
    #[nested]
    step: Step,
    #[nested]
    ramp: Ramp,
    #[nested]
    sine: Sine,
    #[nested]
    square: Square,
    #[nested]
    chirp: Chirp,
    #[nested(order(start = 9))]
    prbs: Prbs,
}

impl Simulate for Bench {
    fn step(&mut self, time: f64, ts: f64) -> Result<(), ModelError> {
        let Self { u, v, .. } = *self;
        self.y_pid = self.pid.update(v, u, ts);
        self.y_first_order = self.first_order.update(u, ts);
        self.y_second_order = self.second_order.update(u, ts);
        self.y_high_pass = self.high_pass.update(u, ts);
        self.y_lead_lag = self.lead_lag.update(u, ts);
        self.y_average = self.average.update(u);
        self.y_saturation = self.saturation.value(u);
        self.y_rate_limiter = self.rate_limiter.update(u, ts);
        self.y_dead_zone = self.dead_zone.value(u);
        self.y_hysteresis = self.hysteresis.update(u);
        self.y_table1 = self.table1.value(u);
        self.y_table2 = self.table2.value(u, v);
        self.y_state_space = self.state_space.update([u]);
        self.y_kalman = self.kalman.update([v], [u])?;
        self.y_step = self.step.value(time);
        self.y_ramp = self.ramp.value(time);
        self.y_sine = self.sine.value(time);
        self.y_square = self.square.value(time);
        self.y_chirp = self.chirp.value(time);
        self.y_prbs = self.prbs.value(time);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use fmu_export::testing::Driver;

    use super::*;

    #[test]
    fn blocks_have_the_same_defaults_in_an_fmu() {
        let bench = Driver::<Bench>::new();
        assert_eq!(bench.pid, Pid::default());
        assert_eq!(bench.first_order, FirstOrder::default());
        assert_eq!(bench.second_order, SecondOrder::default());
        assert_eq!(bench.high_pass, HighPass::default());
        assert_eq!(bench.lead_lag, LeadLag::default());
        assert_eq!(bench.saturation, Saturation::default());
        assert_eq!(bench.rate_limiter, RateLimiter::default());
        assert_eq!(bench.dead_zone, DeadZone::default());
        assert_eq!(bench.hysteresis, Hysteresis::default());
        assert_eq!(bench.step, Step::default());
        assert_eq!(bench.ramp, Ramp::default());
        assert_eq!(bench.sine, Sine::default());
        assert_eq!(bench.square, Square::default());
        assert_eq!(bench.chirp, Chirp::default());
        assert_eq!(bench.prbs, Prbs { order: 9, ..Prbs::default() });
        assert_eq!(bench.kalman.p0, Kalman::<2, 1, 1>::default().p0);
        let (x, y) = ([-2.0, -1.0, 0.5, 2.0], [4.0, 1.0, 0.0, 3.0]);
        assert_eq!(bench.table1, Table1 { x, y, ..Table1::default() });
        let z = [[1.0, 2.0], [3.0, -1.0], [0.5, 4.0]];
        let table = Table2 { x: [-1.0, 0.0, 2.0], y: [-2.0, 1.0], z, ..Table2::default() };
        assert_eq!(bench.table2, table);
    }
}
