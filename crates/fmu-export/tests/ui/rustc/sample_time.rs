//! A sample time that is not of type f64.

use fmu_export::prelude::*;

/// Of another type
#[derive(Model)]
#[model(sample_time = self.count)]
struct Count {
    /** number of something */ #[parameter] count: i32,
}

fn main() {}
