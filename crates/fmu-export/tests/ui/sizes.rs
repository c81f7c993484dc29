//! Numbers of elements in use that are no structural parameters.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Sizes {
    /** of another type */ #[structural_parameter(start = 1, max = 3)] small: u32,
    /** several numbers */ #[structural_parameter(start = 1, max = 3)] several: [u64; 2],
    /** a matrix */ #[parameter(size = "small")] matrix: [[f64; 2]; 3],
    /** a scalar */ #[input(size = "small")] scalar: f64,
    /** discrete */ #[structural_parameter(discrete)] discrete: u64,
}

#[derive(Variables)]
struct Missing {
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

#[derive(Variables)]
struct Parameter {
    /** no structural parameter */ #[parameter(start = 1, max = 3)] nodes: u64,
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

#[derive(Variables)]
struct TooLarge {
    /** number of nodes */ #[structural_parameter(start = 1, max = 4)] nodes: u64,
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

#[derive(Variables)]
struct Unbounded {
    /** number of nodes */ #[structural_parameter(start = 1)] nodes: u64,
    /** list */ #[parameter(size = "nodes")] list: [f64; 3],
}

fn main() {}
