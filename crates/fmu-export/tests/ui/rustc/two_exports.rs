//! Two exports in one library.

use fmu_export::prelude::*;

/// A model
#[derive(Model)]
struct First {}

impl Simulate for First {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

export!(First);
export!(First);

fn main() {}
