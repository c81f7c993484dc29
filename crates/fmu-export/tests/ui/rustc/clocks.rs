//! Clocks of nested structs, their numbers, and traits of clocked models.

use fmu_export::prelude::*;

const TS: f64 = 0.0;

/// A port.
#[derive(Variables)]
struct Port {
    /** ticks */ #[input] rx: Clock,
}

/// In a model with steps
#[derive(Model)]
struct Steps {
    #[nested] port: Port,
}

impl Simulate for Steps {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Without a clock
#[derive(Model)]
#[model(clocked)]
struct None {
    /** gain */ #[parameter] gain: f64,
}

impl Clocked for None {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// With numbers that are none
#[derive(Model)]
#[model(clocked)]
struct Numbers {
    /** zero */ #[input(constant, interval = TS)] zero: Clock,
    /** negative */ #[input(constant, interval = 0.1, shift = -0.1)] negative: Clock,
}

#[derive(Variables)]
struct Units {
    /** a third */ #[input(constant, interval = 0.3333, resolution = 3)] third: Clock,
    /** no unit */ #[input(calculated, interval = 0.1, resolution = 0)] unit: Clock,
    /** ticks */ #[input] tick: Clock,
    /** too long */ #[input(clocks(tick), max_size = 2, start = b"abc")] long: Vec<u8>,
}

#[derive(Variables)]
struct Priority {
    /** below zero */ #[input(priority = 1.5)] half: Clock,
}

impl Clocked for Numbers {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// With steps
#[derive(Model)]
#[model(clocked)]
struct Stepped {
    /** ticks */ #[input] tick: Clock,
}

impl Simulate for Stepped {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// With nothing
#[derive(Model)]
#[model(clocked)]
struct Nothing {
    /** ticks */ #[input] tick: Clock,
}

/// With ticks, but not clocked
#[derive(Model)]
struct Unclocked {}

impl Clocked for Unclocked {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

fn main() {}
