//! Start values and bounds that are literals: outside the bounds, or of another type.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Literals {
    /** below */ #[parameter(start = -1, min = 0)] below: f64,
    /** above */ #[parameter(start = 11, max = 10)] above: i32,
    /** the default */ #[input(min = 1)] default: f64,
    /** an element */ #[parameter(start = [[0.5, 1.5], [0, 2]], max = 1.5)] element: [[f64; 2]; 2],
    /** bounds in the wrong order */ #[parameter(start = 1, min = 2, max = 0)] reversed: f64,
    /** needs a value */ #[constant] constant: f64,
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
    /** beyond its type */ #[parameter(start = 256)] byte: u8,
    /** an element beyond its type */ #[parameter(start = [-129, 0])] signed: [i8; 2],
    /** a bound beyond its type */ #[parameter(min = -1)] unsigned: u64,
    /** infinite */ #[parameter(start = 1e39)] single: f32,
    /** a text for bytes */ #[parameter(start = "abc")] bytes: Vec<u8>,
    /** a text as a bound */ #[parameter(min = "0")] bound: f64,
}

fn main() {}
