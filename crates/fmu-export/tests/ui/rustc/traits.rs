//! Traits that a type does not implement, and values of another type.

use fmu_export::prelude::*;

// A struct that is exported without being a model.

pub struct Plain {
    u: f64,
}

struct Other;

impl Simulate for Other {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

// A model that does not say what it does, and a struct that is no model.

/// A model
#[derive(Model)]
pub struct Still {
    /** input */ #[input] u: f64,
}

export!(Plain, Still);

// Equations, and steps that nobody would take.

/// Takes a step, though it is integrated
#[derive(Model)]
#[model(continuous)]
struct Both {
    /** level */ #[output(state)] x: f64,
    #[derivative(of = x)] x_dot: f64,
}

impl Continuous for Both {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

impl Simulate for Both {
    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Has neither
#[derive(Model)]
struct Neither {
    /** level */ #[output] x: f64,
}

/// Has no equations
#[derive(Model)]
#[model(continuous)]
struct NoEquations {
    /** level */ #[output] x: f64,
}

// An enum without `Choice`, a type alias, and a nested struct without `Variables`.

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

// An enum that is not `Copy`.

/// Form of the control law
#[derive(Choice)]
enum NotCopy {
    /** without feedback */ Open,
}

// An internal field that cannot be reset, copied and saved.

struct Filter;

#[derive(Clone)]
struct Delay;

#[derive(Variables)]
struct Internal {
    filter: Filter,
    delays: [Delay; 2],
}

// A sample time that is not of type f64.

/// Of another type
#[derive(Model)]
#[model(sample_time = self.count)]
struct Count {
    /** number of something */ #[parameter] count: i32,
}

fn main() {}
