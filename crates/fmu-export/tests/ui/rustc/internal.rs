//! An internal field that cannot be reset, copied and saved.

use fmu_export::prelude::*;

struct Filter;

#[derive(Clone)]
struct Delay;

#[derive(Variables)]
struct Internal {
    filter: Filter,
    delays: [Delay; 2],
}

fn main() {}
