//! Solvers that there are not, or without equations.

use fmu_export::prelude::*;

/// With another method
#[derive(Model)]
#[model(continuous, solver = "euler")]
struct Other {}

/// Without equations
#[derive(Model)]
#[model(solver = "implicit")]
struct Stepped {}

fn main() {}
