//! A model with a bug, as an FMU.

use fmu_export::{Model, ModelError, Variable};
use serde::{Deserialize, Serialize};

/// y = u, and a panic if u is negative.
#[derive(Default, Clone, Serialize, Deserialize)]
pub struct Panicking {
    u: f64,
    y: f64,
}

type Row = Variable<Panicking>;

impl Model for Panicking {
    const NAME: &'static str = "Panicking";
    const DESCRIPTION: &'static str = "Model with a bug";
    const VARIABLES: &'static [Row] = &[
        Row::input("u", |m| &mut m.u).about("what must not be negative"),
        Row::output("y", |m| &mut m.y).about("the same"),
    ];

    fn initialize(&mut self, _start_time: f64) -> Result<(), ModelError> {
        Ok(())
    }

    fn step(&mut self, _time: f64, _step: f64) -> Result<(), ModelError> {
        assert!(self.u >= 0.0, "u is {:?}", self.u);
        self.y = self.u;
        Ok(())
    }
}
