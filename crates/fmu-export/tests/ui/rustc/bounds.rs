//! Start values and bounds that do not go together.

use fmu_export::prelude::*;

const GAIN: f64 = 3.0;

#[derive(Variables)]
struct Literals {
    /** below */ #[parameter(start = -1, min = 0)] below: f64,
    /** above */ #[parameter(start = 11, max = 10)] above: i32,
    /** the default */ #[input(min = 1)] default: f64,
    /** an element */ #[parameter(start = [[0.5, 1.5], [0, 2]], max = 1.5)] element: [[f64; 2]; 2],
    /** bounds in the wrong order */ #[parameter(start = 1, min = 2, max = 0)] reversed: f64,
    /** a structural parameter */ #[structural_parameter(start = 4, max = 3)] nodes: u64,
}

#[derive(Variables)]
struct Constants {
    /** a constant expression */ #[parameter(start = 2.0 * GAIN, max = 5)] gain: f64,
    /** an array of them */ #[parameter(start = [1, i32::MAX], max = 5)] counts: [i32; 2],
}

#[derive(Variables)]
struct Infinite {
    /** not finite */ #[parameter(start = f64::INFINITY)] infinite: f64,
    /** beyond its type */ #[parameter(start = 1e39)] single: f32,
}

#[derive(Variables)]
struct NotANumber {
    /** not a number */ #[input(start = [0.0, f64::NAN])] nan: [f64; 2],
}

#[derive(Variables)]
struct Reversed {
    /** no value is allowed */ #[output(min = GAIN, max = -GAIN)] reversed: f64,
}

#[derive(Variables)]
struct Negative {
    /** not a magnitude */ #[output(nominal = -GAIN)] magnitude: f64,
}

#[derive(Variables)]
struct NegativeLiteral {
    /** not a magnitude either */ #[input(nominal = -2)] magnitude: f64,
}

fn main() {}
