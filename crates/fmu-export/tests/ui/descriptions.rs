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
enum Undescribed {
    Open,
    /** with feedback */ Closed,
}

#[derive(Clone, Copy, Choice)]
enum Form {
    /** an item */ Item,
}

fn main() {}
