//! Logs that a host cannot tell apart.

use fmu_export::prelude::*;

/// A model
#[derive(Model)]
struct Categories {
    #[log(category = "without_comment")] without_comment: Log,
    /** with a name of the exporter */ #[log(category = "logEvents")] reserved: Log,
    /** without a name */ #[log(category = "")] empty: Log,
    /** misspelled */ #[log(categroy = "limits")] misspelled: Log,
}

/// A model
#[derive(Model)]
struct SameCategory {
    /** limits */ #[log(category = "limits")] one: Log,
    /** limits */ #[log(category = "limits")] other: Log,
}

/// A model
#[derive(Model)]
struct NoCategory {
    #[log] one: Log,
    #[log] other: Log,
}

#[derive(Variables)]
struct Group {
    #[log] log: Log,
}

fn main() {}
