//! Names that occur twice because of nested structs.

use fmu_export::prelude::*;

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

fn main() {}
