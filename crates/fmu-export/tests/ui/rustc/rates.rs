//! Methods of rates that are missing or have another form, and traits that do not go with rates.

use fmu_export::prelude::*;

/// Without a method
#[derive(Model)]
#[model(rates(slow = 0.1, fast = 0.01))]
struct Forgotten {}

impl Forgotten {
    fn slow(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

impl MultiRate for Forgotten {}

/// Without a result
#[derive(Model)]
#[model(rates(slow = 0.1))]
struct Resultless {}

impl Resultless {
    fn slow(&mut self, _time: f64, _step: f64) {}
}

impl MultiRate for Resultless {}

/// Without a start
#[derive(Model)]
#[model(rates(slow = 0.1))]
struct Startless {}

impl Startless {
    fn slow(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Without rates
#[derive(Model)]
struct Rateless {}

impl MultiRate for Rateless {}

fn main() {}
