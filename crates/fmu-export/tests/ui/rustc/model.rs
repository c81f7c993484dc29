//! A struct that is exported without being a model.

use fmu_export::prelude::*;

pub struct Plain {
    u: f64,
}

export!(Plain);

struct Other;

impl Simulate for Other {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

fn main() {}
