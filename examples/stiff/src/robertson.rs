use fmu_export::prelude::*;

/// Robertson's chemical reaction, a stiff model: its parts take from 1e-4 s to 1e11 s
#[derive(Model)]
#[model(continuous, solver = "implicit", stop_time = 40, step_size = 0.4)]
pub struct Robertson {
    /// concentration of A
    #[output(state, start = 1)]
    a: f64,
    /// concentration of B
    #[output(state, nominal = 1e-5)]
    b: f64,
    /// concentration of C
    #[output(state)]
    c: f64,
    #[derivative(of = a, unit = "1/s")]
    a_rate: f64,
    #[derivative(of = b, unit = "1/s")]
    b_rate: f64,
    #[derivative(of = c, unit = "1/s")]
    c_rate: f64,
}

impl Continuous for Robertson {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        let first = 0.04 * self.a - 1e4 * self.b * self.c;
        let second = 3e7 * self.b * self.b;
        (self.a_rate, self.b_rate, self.c_rate) = (-first, first - second, second);
        Ok(())
    }
}
