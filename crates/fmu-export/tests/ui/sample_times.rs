//! Sample times that are no positive numbers.

use fmu_export::prelude::*;

/// As a text
#[derive(Model)]
#[model(sample_time = "1 ms")]
struct Text {}

/// Negative
#[derive(Model)]
#[model(sample_time = -0.1)]
struct Negative {}

fn main() {}
