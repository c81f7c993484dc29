use fmu_export::prelude::*;

/// Room with a thermostat, a model with an event that an input causes
#[derive(Model)]
#[model(continuous, stop_time = 100, step_size = 0.1)]
pub struct Thermostat {
    /// Set-point of the temperature
    #[input(unit = "degC", start = 20)]
    set_point: f64,
    /// Whether somebody has opened the window
    #[input]
    window: bool,
    /// Temperature
    #[output(state, unit = "degC", start = 20)]
    temperature: f64,
    #[derivative(of = temperature, unit = "K/s")]
    rate: f64,
    /// Whether the heater is on
    #[output]
    is_on: bool,
    /// Temperature above which the heater switches off, or on below
    #[event_indicator(unit = "K")]
    excess: f64,
    is_open: bool,
}

/// Temperature outside (degC).
const OUTSIDE: f64 = 20.0;
/// Half of the hysteresis (K).
const HALF: f64 = 0.5;

impl Continuous for Thermostat {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        let time_constant = if self.is_open { 10.0 } else { 50.0 };
        let heat = if self.is_on { 0.5 } else { 0.0 };
        self.rate = (OUTSIDE - self.temperature) / time_constant + heat;
        let half = if self.is_on { HALF } else { -HALF };
        self.excess = self.temperature - self.set_point - half;
        Ok(())
    }

    fn event(&mut self, _time: f64) -> Result<(), ModelError> {
        self.is_open = self.window;
        self.is_on = if self.is_on { self.excess < 0.0 } else { self.excess <= 0.0 };
        Ok(())
    }
}
