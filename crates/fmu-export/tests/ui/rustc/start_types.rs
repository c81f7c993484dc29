//! Start values and bounds of another type than the variable.

use fmu_export::prelude::*;

const GAIN: f64 = 3.0;
const WEIGHTS: [f64; 2] = [1.0, 2.0];

/// Form of the control law
#[derive(Clone, Copy, Choice)]
enum Law {
    /** without feedback */ Open,
}

#[derive(Variables)]
struct Mismatch {
    /** a text */ #[parameter(start = "2")] gain: f64,
    /** a number */ #[parameter(start = 1)] flag: bool,
    /** a fraction */ #[parameter(start = 0.5)] count: i32,
    /** too few */ #[parameter(start = [1, 2])] weights: [f64; 3],
    /** an array */ #[parameter(start = [1, 2])] scalar: f64,
    /** half an array */ #[parameter(start = [1, 2])] matrix: [[f64; 2]; 2],
    /** a number for an item */ #[parameter(start = 1)] law: Law,
    /** a bound beyond its type */ #[parameter(min = -1)] unsigned: u64,
    /** a text for bytes */ #[parameter(start = "abc")] bytes: Vec<u8>,
    /** a text as a bound */ #[parameter(min = "0")] bound: f64,
    /** another length */ #[parameter(start = WEIGHTS)] longer: [f64; 3],
    /** another type */ #[parameter(start = GAIN)] real: i32,
}

fn main() {}
