//! Options that do not exist, or not for this role or type.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Options {
    /** not a parameter */ #[input(tunable)] tunable: f64,
    /** misspelled */ #[output(units = "m")] unknown: f64,
    /** not a variable */ #[nested(unit = "m")] nested: Group,
    /** no member */ #[input(terminal = "loop")] terminal: f64,
    /** two roles */ #[input] #[output] both: f64,
    /** no bounds */ #[parameter(min = 0)] flag: bool,
    /** only a whole f64 has one */ #[input(derivative = self.slope)] inputs: [f64; 2],
    /** of an array */ #[output(derivative_by(tunable = 1.0))] outputs: [f64; 2],
    /** not bytes */ #[input(mime_type = "text/plain")] text: String,
    /** a word */ #[input(unit)] word: f64,
    /** an assignment */ #[parameter = 3] assigned: f64,
    /** twice */ #[input(start = 1, start = 2)] twice: f64,
    /** without a magnitude */ #[input(nominal = 2)] flags: bool,
    /** needs a value */ #[constant] constant: f64,
    #[nested] groups: [[Group; 2]; 2], #[nested(flatten)] flat: [Group; 2],
    slope: f64,
}

#[derive(Variables)]
struct Group {}

/// A model
#[derive(Model)]
#[model(sampletime = 0.1)]
struct UnknownOption {}

#[derive(Variables)]
struct Misspelled {
    /** a letter too many */ #[parameter(tuneable)] gain: f64,
    /** letters exchanged */ #[parameter(strat = 1)] start: f64,
    /** another word */ #[parameter(default = 1)] default: f64,
}

/// Another convention
#[derive(Model)]
#[model(naming = "simulink")]
struct UnknownNaming {}

fn main() {}
