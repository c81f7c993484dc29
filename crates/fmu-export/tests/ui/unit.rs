//! Units that are unknown, or of a type that has none.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Units {
    /** misspelled */ #[input(unit = "radians")] angle: f64,
    /** part of a product */ #[input(unit = "N.foo/s")] force: f64,
    /** no product */ #[input(unit = "Nm")] torque: f64,
    /** a count */ #[input(unit = "m")] count: i32,
    /** no text */ #[input(unit = 1)] number: f64,
}

/// What uses a type whose derive failed is not reported as well.
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
