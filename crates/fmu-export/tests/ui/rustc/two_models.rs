//! Two models with one name, here of a generic struct.

use fmu_export::prelude::*;

/// A model
#[derive(Model)]
struct Lists<const N: usize> {
    /** list */ #[parameter] list: [f64; N],
}

impl<const N: usize> Simulate for Lists<N> {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

export!(Lists<2>, Lists<3>);

fn main() {}
