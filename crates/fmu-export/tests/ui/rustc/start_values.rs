//! Start values outside the bounds, and of another type, that only the compiler can evaluate.

use fmu_export::prelude::*;

const GAIN: f64 = 3.0;

#[derive(Variables)]
struct Constants {
    /** a constant expression */ #[parameter(start = 2.0 * GAIN, max = 5)] gain: f64,
    /** an array of them */ #[parameter(start = [1, i32::MAX], max = 5)] counts: [i32; 2],
}

#[derive(Variables)]
struct Infinite {
    /** not finite */ #[parameter(start = f64::INFINITY)] infinite: f64,
}

#[derive(Variables)]
struct NotANumber {
    /** not a number */ #[input(start = [0.0, f64::NAN])] nan: [f64; 2],
}

const WEIGHTS: [f64; 2] = [1.0, 2.0];

#[derive(Variables)]
struct Mismatch {
    /** another length */ #[parameter(start = WEIGHTS)] weights: [f64; 3],
    /** another type */ #[parameter(start = GAIN)] count: i32,
}

#[derive(Variables)]
struct Reversed {
    /** no value is allowed */ #[output(min = GAIN, max = -GAIN)] reversed: f64,
}

#[derive(Variables)]
struct Negative {
    /** not a magnitude */ #[output(nominal = -GAIN)] magnitude: f64,
}

fn main() {}
