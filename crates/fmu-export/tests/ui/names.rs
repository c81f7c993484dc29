//! Names that occur twice in a struct, or are no names of FMI.

use fmu_export::prelude::*;

/// One name twice
#[derive(Variables)]
struct Twice {
    /** angle */ #[input] y: f64,
    /** the same angle */ #[output(name = "y")] angle: f64,
}

/// Not names
#[derive(Variables)]
struct NotNames {
    /** with a space */ #[output(name = "om ega")] omega: f64,
    /** starts with a digit */ #[output(name = "2nd")] second: f64,
    /** with an empty part */ #[output(name = "a..b")] part: f64,
    /** not ASCII */ #[output] größe: f64,
    #[nested(prefix = "my pid")] pid: Twice,
    #[nested(prefix = "a", flatten)] both: Twice,
}

/// The name of the independent variable
#[derive(Model)]
struct Clock {
    /** time of the day */ #[input] time: f64,
}

/// Not a name either
#[derive(Model)]
#[model(name = "My model")]
struct Named {}

/// Nor this
#[derive(Clone, Copy, Choice)]
enum Law {
    /** with a space */ #[choice(name = "open loop")] Open,
}

/// Two items of one name
#[derive(Clone, Copy, Choice)]
enum Items {
    /** one */ OpenLoop,
    /** another */ #[choice(name = "open_loop")] Open,
}

fn main() {}
