//! Options of variables of a nested struct.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Group {
    #[nested(k(unit = "newton"))] unit: Gain,
    #[nested(k(unit = 1))] number: Gain,
    #[nested(k())] nothing: Gain,
    #[nested(k(strat = 1))] misspelled: Gain,
}

#[derive(Variables)]
struct Gain {
    /** gain */ #[parameter(start = 1, max = 10)] k: f64,
}

fn main() {}
