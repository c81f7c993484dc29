//! A type whose derive failed: the mistake is reported, but not what follows from it.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Units {
    /** misspelled */ #[input(unit = "radians")] angle: f64,
}

/// Uses such a type
#[derive(Model)]
struct Plant {
    /** speed */ #[output(unit = "kmph")] speed: f64,
    #[nested] units: Units,
}

impl Simulate for Plant {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

export!(Plant);

fn main() {}
