//! Mistakes of a model that the compiler finds where it is exported.

use fmu_export::prelude::*;

const GAIN: f64 = 3.0;

const LENGTH: usize = 3;

/// Has a structural parameter that exceeds an array of constant length
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

/// Is generic, so that it is checked here
#[derive(Model)]
struct Generic<const N: usize> {
    /** gains */ #[parameter(start = -1, min = 0)] gains: [f64; N],
}

impl<const N: usize> Simulate for Generic<N> {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

export!(Lists, Sloped, Ended, Generic<2>);

fn main() {}
