//! Missing descriptions.

use fmu_export::prelude::*;

#[derive(Model)]
struct Nameless {}

/// A model
#[derive(Model)]
struct WithoutDescription {
    #[input] y: f64,
    #[output(description = "")] u: f64,
}

/// A law
#[derive(Clone, Copy, Choice)]
enum Law {
    Open,
    /** with feedback */ Closed,
}

#[derive(Clone, Copy, Choice)]
enum Other {
    /** an item */ Item,
}

fn main() {}
