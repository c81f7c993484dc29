use fmu_export::prelude::*;

/// A mass that falls onto a stiff spring and damper, with an event at the contact
#[derive(Model)]
#[model(continuous, solver = "implicit", stop_time = 1, step_size = 0.01)]
pub struct Contact {
    /// height above the spring
    #[output(state, unit = "m", start = 1)]
    x: f64,
    /// velocity
    #[output(state, unit = "m/s")]
    v: f64,
    /// whether the mass is in contact
    #[output]
    closed: bool,
    #[derivative(of = x, unit = "m/s", derivative_by(v = 1.0))]
    x_rate: f64,
    #[derivative(of = v, unit = "m/s2", derivative_by(
        x = -self.stiffness_in_contact(),
        v = -self.damping_in_contact()
    ))]
    v_rate: f64,
    /// height, which is zero at the contact
    #[event_indicator(unit = "m", derivative_by(x = 1.0))]
    gap: f64,
    /// stiffness by mass
    #[parameter(start = 1e8, min = 0, unit = "1/s2")]
    stiffness: f64,
    /// damping by mass
    #[parameter(start = 1e6, min = 0, unit = "1/s")]
    damping: f64,
}

impl Contact {
    fn stiffness_in_contact(&self) -> f64 {
        if self.closed { self.stiffness } else { 0.0 }
    }

    fn damping_in_contact(&self) -> f64 {
        if self.closed { self.damping } else { 0.0 }
    }
}

impl Continuous for Contact {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        let force = -self.stiffness_in_contact() * self.x - self.damping_in_contact() * self.v;
        (self.x_rate, self.v_rate, self.gap) = (self.v, force - 9.81, self.x);
        Ok(())
    }

    fn event(&mut self, _time: f64) -> Result<(), ModelError> {
        self.closed = self.x <= 0.0;
        Ok(())
    }
}
