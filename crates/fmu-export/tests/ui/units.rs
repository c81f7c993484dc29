//! Units that are unknown, or of a type that has none.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Units {
    /** misspelled */ #[input(unit = "radians")] angle: f64,
    /** part of a product */ #[input(unit = "N.foo/s")] force: f64,
    /** no product */ #[input(unit = "Nm")] torque: f64,
    /** a count */ #[input(unit = "m")] count: i32,
    /** no text */ #[input(unit = 1)] number: f64,
    /** displayed in another dimension */ #[output(unit = "rad/s", display = "Hz")] speed: f64,
    /** displayed in an unknown unit */ #[output(unit = "K", display = "celsius")] heat: f64,
    /** displayed without a unit */ #[output(display = "rpm")] slip: f64,
}

fn main() {}
