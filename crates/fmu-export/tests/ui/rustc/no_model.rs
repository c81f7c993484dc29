//! Exports of a struct that is no model, and of a model that does not say what it does.

use fmu_export::prelude::*;

pub struct Plain {
    u: f64,
}

struct Other;

impl Simulate for Other {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// A model
#[derive(Model)]
pub struct Still {
    /** input */ #[input] u: f64,
}

export!(Plain, Still);

fn main() {}
