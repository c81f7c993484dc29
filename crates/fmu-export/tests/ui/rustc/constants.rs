//! What only the compiler can evaluate.

use fmu_export::prelude::*;

// Start values outside the bounds, and of another type, that only the compiler can evaluate.

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

// Dependencies on variables of nested structs that do not exist.

#[derive(Variables)]
struct Start {
    /** at the start */ #[parameter] y0: f64,
}

#[derive(Variables)]
struct Plant {
    #[nested] start: Start,
    /** output */ #[output(initially_from("start.y0", "start.z0"))] y: f64,
}

// Names that occur twice because of nested structs.

#[derive(Variables)]
struct Pid {
    /** gain */ #[parameter] kp: f64,
}

#[derive(Variables)]
struct Prefixed {
    /** gain */ #[parameter(name = "pid.kp")] gain: f64,
    #[nested] pid: Pid,
}

#[derive(Variables)]
struct Flattened {
    #[nested(flatten)] pid: Pid,
    /** gain */ #[parameter] kp: f64,
}

#[derive(Variables)]
struct SamePrefix {
    #[nested(prefix = "a")] one: Pid,
    #[nested(prefix = "a")] other: Pid,
}

// A discriminant of which only the lowest 32 bits would be left.

/// State of the plant
#[derive(Clone, Copy, Choice)]
#[repr(u32)]
enum Code {
    /** negative in FMI */ Failed = 0x8000_0000,
}

#[derive(Variables)]
struct Codes {
    /** code */ #[output] code: Code,
}

// A structural parameter that exceeds an array of constant length, which only the compiler can evaluate.

const LENGTH: usize = 3;

/// A model
#[derive(Model)]
struct Lists {
    /** number of nodes */ #[structural_parameter(start = 1, max = 4)] nodes: u64,
    /** list */ #[parameter(size = "nodes")] list: [f64; LENGTH],
}

impl Simulate for Lists {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Does not use the slope of its input
#[derive(Model)]
#[model(continuous)]
struct Sloped {
    /** rate */ #[input(derivative = self.slope)] u: f64,
    slope: f64,
}

impl Continuous for Sloped {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Ends before it starts
#[derive(Model)]
#[model(stop_time = -GAIN)]
struct Ended {}

impl Simulate for Ended {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

export!(Lists, Sloped, Ended);

fn main() {}
