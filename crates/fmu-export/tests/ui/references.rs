//! Value references where they cannot be fixed.
use fmu_export::prelude::*;

/// A part
#[derive(Variables)]
struct Part {
    /// gain
    #[parameter(reference = 3)]
    gain: f64,
}

/// A model
#[derive(Model)]
struct Whole {
    #[nested(references = 3)]
    part: Part,
    /// gain
    #[parameter(references(gain = 3))]
    gain: f64,
}

fn main() {}
