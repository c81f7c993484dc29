//! Structs and enums that are no models, groups of variables or enumerations.

use fmu_export::prelude::*;

/// A model
#[derive(Model)]
struct Tuple(f64);

/// A model
#[derive(Model)]
enum Enum {
    /** item */ Item,
}

/// Borrowed
#[derive(Model)]
struct Borrowed<'a> {
    /** gain */ #[parameter] gain: f64,
    table: &'a [f64],
}

/// Valued
#[derive(Clone, Copy, Choice)]
enum Valued {
    /** with a field */ Value(f64),
}

/// No items
#[derive(Clone, Copy, Choice)]
enum Empty {}

fn main() {}
