//! Changes of variables of a nested struct that their types do not allow.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Changes {
    #[nested(kq(start = 1))] unknown: Gain,
    #[nested(k(start = 20))] too_large: Gain,
    #[nested(k(min = 2))] too_small: Gain,
    #[nested(w(start = 1))] too_few: Gain,
    #[nested(k(start = true))] other_type: Gain,
    #[nested(y(start = 1))] computed: Gain,
    #[nested(is_on(unit = "N"))] without_unit: Gain,
}

#[derive(Variables)]
struct Gain {
    /** gain */ #[parameter(start = 1, max = 10)] k: f64,
    /** weights */ #[parameter] w: [f64; 2],
    /** state */ #[parameter] is_on: bool,
    /** result */ #[output] y: f64,
}

fn main() {}
