//! Dependencies on variables that do not exist.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Plain {
    /** at the start */ #[parameter] y0: f64,
    /** output */ #[output(initially_from("y0", "z0"))] y: f64,
}

#[derive(Variables)]
struct Derivative {
    /** input */ #[input] force: f64,
    /** not an input */ #[parameter] gain: f64,
    /** output */ #[output(derivative_by(force = 1.0, gain = 2.0))] y: f64,
}

#[derive(Variables)]
struct Constant {
    /** of nothing */ #[output(derivative_by())] y: f64,
}

fn main() {}
