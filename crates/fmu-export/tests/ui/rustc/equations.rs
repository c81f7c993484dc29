//! Equations that are missing, and steps that nobody would take.

use fmu_export::prelude::*;

/// Takes a step, though it is integrated
#[derive(Model)]
#[model(continuous)]
struct Both {
    /** level */ #[output(state)] x: f64,
    #[derivative(of = x)] x_dot: f64,
}

impl Continuous for Both {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

impl Simulate for Both {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Has neither
#[derive(Model)]
struct Neither {
    /** level */ #[output] x: f64,
}

/// Has no equations
#[derive(Model)]
#[model(continuous)]
struct NoEquations {
    /** level */ #[output] x: f64,
}

fn main() {}
