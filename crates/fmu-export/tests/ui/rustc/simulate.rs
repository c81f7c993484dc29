//! A model that does not say what it does, and a struct that is no model.

use fmu_export::prelude::*;

/// A model
#[derive(Model)]
pub struct Still {
    /** input */ #[input] u: f64,
}

export!(Still);

fn main() {}
