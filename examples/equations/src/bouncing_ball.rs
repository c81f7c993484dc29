use fmu_export::prelude::*;

/// Bouncing ball, a model with a state event
#[derive(Model)]
#[model(continuous, stop_time = 3, step_size = 0.01)]
pub struct BouncingBall {
    /// Height
    #[output(state, unit = "m", initially_from("h0"))]
    h: f64,
    /// Velocity, positive upwards
    #[output(state, unit = "m/s")]
    v: f64,
    #[derivative(of = h)]
    h_rate: f64,
    #[derivative(of = v)]
    v_rate: f64,
    /// Height at the start
    #[parameter(start = 1, min = 1e-3, unit = "m")]
    h0: f64,
    /// Gravitational acceleration
    #[parameter(start = 9.81, min = 1e-3, unit = "m/s2")]
    g: f64,
    /// Coefficient of restitution
    #[parameter(tunable, start = 0.7, min = 0.5, max = 1, unit = "1")]
    e: f64,
    /// Velocity after a bounce below which the ball stays on the ground
    #[parameter(tunable, start = 0.1, min = 1e-6, unit = "m/s")]
    v_min: f64,
    /// Distance to the ground, while the ball bounces
    #[event_indicator]
    contact: f64,
    rests: bool,
}

impl Continuous for BouncingBall {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.h = self.h0;
        Ok(())
    }

    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        self.h_rate = self.v;
        self.v_rate = if self.rests { 0.0 } else { -self.g };
        self.contact = if self.rests { 1.0 } else { self.h };
        Ok(())
    }

    fn event(&mut self, _time: f64) -> Result<(), ModelError> {
        // Just after the ball has left the ground, the solver may find the indicator's sign change again.
        if self.h <= 0.0 && self.v < 0.0 {
            self.h = 0.0;
            self.v *= -self.e;
            if self.v < self.v_min {
                self.v = 0.0;
                self.rests = true;
            }
        }
        Ok(())
    }
}
