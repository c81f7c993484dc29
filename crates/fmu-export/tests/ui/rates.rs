//! Rates that are none.

use fmu_export::prelude::*;

/// Without rates
#[derive(Model)]
#[model(rates())]
struct Empty {}

/// Without methods
#[derive(Model)]
#[model(rates = 0.1)]
struct Assigned {}

/// Of the same name
#[derive(Model)]
#[model(rates(fast = 0.1, fast = 0.2))]
struct Twice {}

/// Not positive
#[derive(Model)]
#[model(rates(slow = 0.1, fast = 0))]
struct Zero {}

/// With another sample time
#[derive(Model)]
#[model(sample_time = 1, rates(slow = 0.1, fast = 0.01))]
struct Both {}

/// With equations
#[derive(Model)]
#[model(continuous, rates(slow = 0.1, fast = 0.01))]
struct Equations {}

fn main() {}
