//! Fields of types that lack a trait.

use fmu_export::prelude::*;

#[derive(Clone, Copy)]
enum Law {
    Open,
}

type Angle = f64;

#[derive(Variables)]
struct Types {
    /** an enum */ #[parameter] law: Law,
}

#[derive(Variables)]
struct Aliased {
    /** an alias */ #[input] angle: Angle,
}

struct Group;

#[derive(Variables)]
struct Nested {
    #[nested] group: Group,
}

/// Form of the control law
#[derive(Choice)]
enum NotCopy {
    /** without feedback */ Open,
}

fn main() {}
