use fmu_export::prelude::*;

/// Van der Pol oscillator, a model with directional derivatives
#[derive(Model)]
#[model(continuous, stop_time = 20, step_size = 0.01, tolerance = 1e-9)]
pub struct VanDerPol {
    /// First state
    #[output(state)]
    x0: f64,
    /// Second state
    #[output(state)]
    x1: f64,
    #[derivative(of = x0, derivative_by(x1 = 1.0))]
    x0_rate: f64,
    #[derivative(of = x1, derivative_by(
        x0 = -2.0 * self.mu * self.x0 * self.x1 - 1.0,
        x1 = self.mu * (1.0 - self.x0 * self.x0)
    ))]
    x1_rate: f64,
    /// Damping
    #[parameter(start = 1, min = 0)]
    mu: f64,
}

impl Continuous for VanDerPol {
    fn initialize(&mut self, _start: &Start) -> Result<(), ModelError> {
        self.x0 = 2.0;
        Ok(())
    }

    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        self.x0_rate = self.x1;
        self.x1_rate = self.mu * (1.0 - self.x0 * self.x0) * self.x1 - self.x0;
        Ok(())
    }
}
