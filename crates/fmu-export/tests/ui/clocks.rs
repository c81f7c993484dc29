//! Clocks whose options do not go with their kinds, and models that have none or do not act at their ticks.

use fmu_export::prelude::*;

#[derive(Variables)]
struct Options {
    /** a parameter */ #[parameter] parameter: Clock,
    /** of no use outside */ #[local] local: Clock,
    /** several */ #[input] several: [Clock; 2],
    /** with a start */ #[input(start = true)] start: Clock,
    /** by the model */ #[output(constant, interval = 0.1)] output: Clock,
    /** of two kinds */ #[input(fixed, countdown)] kinds: Clock,
    /** without an interval */ #[input(constant)] interval: Clock,
    /** no interval */ #[input(constant, interval = 0)] zero: Clock,
    /** before the last tick */ #[input(fixed, interval = -0.1)] negative: Clock,
    /** of no kind */ #[input(interval = 0.1)] triggered: Clock,
    /** that it says itself */ #[input(countdown, interval = 0.1)] countdown: Clock,
    /** that it may not */ #[input(constant, interval = self.ts)] calculated: Clock,
    /** without a constant interval */ #[input(tunable, interval = 0.1, shift = self.ts)] shifted: Clock,
    /** without a constant */ #[input(calculated, interval = self.ts, resolution = self.n)] units: Clock,
    ts: f64,
    n: u64,
}

#[derive(Variables)]
struct OfOthers {
    /** ticks */ #[input] tick: Clock,
    /** by none */ #[input(clocks())] none: f64,
    /** by a word */ #[input(clocks = "tick")] word: f64,
    /** a state */ #[output(state, clocks(tick))] x: f64,
    #[derivative(of = x)] x_dot: f64,
    /** with slopes */ #[input(clocks(tick), derivative = self.gain)] slope: f64,
    /** no clock */ #[input(countdown)] counted: f64,
    /** no bytes */ #[input(max_size = 8)] sized: String,
    /** gain */ #[parameter] gain: f64,
}

#[derive(Variables)]
struct Number {
    /** not by a number */ #[input(clocks(gain))] input: f64,
    /** gain */ #[parameter] gain: f64,
}

#[derive(Variables)]
struct Missing {
    /** not by anything */ #[input(clocks("missing"))] nothing: f64,
}

#[derive(Variables)]
struct Own {
    /** not by itself */ #[input(clocks(own))] own: Clock,
}

#[derive(Variables)]
struct Network {
    /** ticks */ #[input(network = "Rx_Clock")] tick: Clock,
    /** no role */ #[input(clocks(tick), network = "Rx")] role: Vec<u8>,
    /** the other way */ #[output(clocks(tick), network = "Rx_Data")] data: Vec<u8>,
    /** no clock */ #[input(network = "Tx_Clock")] clock: bool,
    /** no parameter */ #[output(network = "Configuration.Rate")] rate: f64,
}

/// With an interval of its own
#[derive(Model)]
#[model(clocked, sample_time = 0.1)]
struct Sampled {
    /** ticks */ #[input] tick: Clock,
}

/// With rates
#[derive(Model)]
#[model(clocked, rates(fast = 0.1))]
struct Rates {
    /** ticks */ #[input] tick: Clock,
}

/// With equations
#[derive(Model)]
#[model(clocked, continuous)]
struct Equations {
    /** ticks */ #[input] tick: Clock,
}

/// Without a function
#[derive(Model)]
struct Steps {
    /** ticks */ #[input] tick: Clock,
}

/// With a sample time
#[derive(Model)]
#[model(sample_time = 0.1)]
struct Samples {
    /** ticks */ #[input] tick: Clock,
}

fn main() {}
