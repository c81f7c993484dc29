//! Attributes of internal fields that are incomplete, or elsewhere.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Fields {
    /** has a start value */ #[input] #[fresh(1.0)] u: f64,
    #[nested] #[fresh(Part {})] part: Part,
    #[fresh] without_value: f64,
    #[saved] without_module: f64,
    #[saved(with = "no path")] no_path: f64,
    #[copied(with = module)] copied: f64,
    #[copied] #[unsaved] both: f64,
}

#[derive(Variables)]
struct Part {}

#[derive(Default, Variables)]
#[variables(default)]
struct Whole {
    #[fresh(1.0)] number: f64,
}

fn main() {}
