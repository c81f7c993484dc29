//! Former names that are no names, or names of others, and deprecation without advice.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Forms {
    /** no name */ #[input(alias = "pid kp")] a: f64,
    /** the time */ #[output(alias("b_old", "time"))] b: f64,
    /** no text */ #[parameter(alias = 1)] c: f64,
    /** no advice */ #[parameter(deprecated = "")] d: f64,
}

#[derive(Variables)]
struct Names {
    /** gain */ #[parameter(alias = "k")] kp: f64,
    /** of another */ #[parameter(alias = "kp")] ki: f64,
}

#[derive(Variables)]
struct Aliases {
    /** gain */ #[parameter(alias = "k")] kp: f64,
    /** of another */ #[parameter(alias("kd_old", "k"))] kd: f64,
}

fn main() {}
