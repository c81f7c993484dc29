//! Mistakes in value references that a model fixes.
use fmu_export::prelude::*;

/// A part
#[derive(Variables)]
struct Part {
    /// gain
    #[parameter]
    gain: f64,
    /// result
    #[output]
    result: f64,
}

/// Two have the same
#[derive(Model)]
struct Taken {
    /// weights
    #[parameter(reference = 10)]
    weights: [f64; 3],
    /// gain
    #[parameter(reference = 12)]
    gain: f64,
    /// result
    #[output]
    result: f64,
}

impl Simulate for Taken {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// One is too large, and one belongs to nothing
#[derive(Model)]
struct Far {
    /// gain
    #[parameter(reference = 10_000)]
    gain: f64,
    #[nested(references("offset" = 5))]
    part: Part,
}

impl Simulate for Far {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

fn main() {}
