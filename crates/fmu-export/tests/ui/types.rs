//! Types that a variable cannot have.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Types {
    /** a size that depends on the platform */ #[input] size: usize,
    /** any number of elements */ #[input] list: Vec<f64>,
    /** too large */ #[input] count: u128,
    /** may be missing */ #[input] option: Option<f64>,
    /** borrowed */ #[parameter] text: &'static str,
    /** a tuple */ #[input] pair: (f64, f64),
    /** of an unsupported type */ #[input] array: [char; 3],
}

fn main() {}
