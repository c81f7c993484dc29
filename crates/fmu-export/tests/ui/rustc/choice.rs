//! An enum that is not `Copy`.

use fmu_export::prelude::*;

/// Form of the control law
#[derive(Choice)]
enum Law {
    /** without feedback */ Open,
}

fn main() {}
