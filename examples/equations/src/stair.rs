use fmu_export::prelude::*;

/// A counter of seconds, a model with time events
#[derive(Model)]
#[model(continuous, stop_time = 10, step_size = 0.2)]
pub struct Stair {
    /// Number of seconds that have begun
    #[output]
    counter: i32,
}

impl Stair {
    /// The time at which the next second begins (s).
    fn next(&self) -> f64 {
        f64::from(self.counter)
    }
}

impl Continuous for Stair {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        // The times of hosts have rounding errors.
        if time > self.next() - 1e-9 && self.counter < i32::MAX {
            self.counter += 1;
        }
        Ok(())
    }

    fn next_event(&self, _time: f64) -> Option<f64> {
        Some(self.next())
    }
}
