//! Dependencies on variables of nested structs that do not exist.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Start {
    /** at the start */ #[parameter] y0: f64,
}

#[derive(Variables)]
struct Plant {
    #[nested] start: Start,
    /** output */ #[output(initially_from("start.y0", "start.z0"))] y: f64,
}

fn main() {}
