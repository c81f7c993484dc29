//! Types that are not those of a variable.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Types {
    /// single precision
    #[input]
    single: f32,
    /// any number of elements
    #[input]
    list: Vec<f64>,
    /// unsigned
    #[input]
    count: u32,
    /// may be missing
    #[input]
    option: Option<f64>,
    /// borrowed
    #[parameter]
    text: &'static str,
    /// a tuple
    #[input]
    pair: (f64, f64),
    /// of an unsupported type
    #[input]
    array: [u8; 3],
}

fn main() {}
