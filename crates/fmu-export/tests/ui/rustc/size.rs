//! A structural parameter that exceeds an array of constant length, which only the compiler can evaluate.

use fmu_export::prelude::*;

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

export!(Lists);

fn main() {}
