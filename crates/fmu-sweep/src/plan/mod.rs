//! The parameters of a sweep and their values.
//!
//! A plan is read from TOML, or any other format that the caller parses with serde:
//!
//! ```toml
//! seed = 1                    # of the random numbers; 0 if left out
//! draws = 200                 # of the random numbers at each point of the grid; 1 if left out
//!
//! [[parameter]]
//! variable = "controller.pid.kp"
//! values = [200, 300, 400]    # numbers, booleans or strings
//!
//! [[parameter]]
//! variable = "plant.M"
//! from = 0.5
//! to = 2.0
//! count = 16                  # evenly spaced, both ends included; scale = "log" for even ratios
//!
//! [[parameter]]
//! variable = "plant.l"
//! uniform = [0.2, 0.3]        # or log_uniform = [min, max], or normal = [mean, deviation]
//!
//! [[parameter]]
//! variables = ["controller.rbf.eta", "supervisor.rbf.eta"]    # the same value for both
//! values = [0.1, 0.2]
//! ```
//!
//! The grid consists of all combinations of listed and spaced values. The runs iterate over the grid,
//! the first parameter varying slowest, with all draws at each grid point.

mod draw;
mod parameter;

use std::collections::HashSet;
use std::ops::Range;

use serde::Deserialize;

use crate::{Cell, Column, Error, Row, Value};
pub use parameter::Parameter;

/// Maximum number of runs; more are assumed to be a mistake.
const MAX_RUNS: u64 = 1_000_000_000;

/// The parameters of every run.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "Description")]
pub struct Plan {
    seed: u64,
    draws: u64,
    parameters: Vec<Parameter>,
    runs: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Description {
    #[serde(default)]
    seed: u64,
    #[serde(default = "one")]
    draws: u64,
    #[serde(default)]
    parameter: Vec<Parameter>,
}

fn one() -> u64 {
    1
}

impl TryFrom<Description> for Plan {
    type Error = Error;

    fn try_from(description: Description) -> Result<Self, Error> {
        Self::new(description.seed, description.draws, description.parameter)
    }
}

/// One run of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Run<'a> {
    /// The index of the run, from 0.
    pub index: u64,
    /// Variables and their values, in the order of the plan.
    pub assignments: Vec<(&'a str, Value)>,
}

impl Run<'_> {
    /// The row of the run: its parameters and its results.
    pub fn row(&self, results: impl IntoIterator<Item = Cell>) -> Row {
        let parameters = self
            .assignments
            .iter()
            .map(|(_, value)| Some(value.clone()));
        Row {
            index: self.index,
            cells: parameters.chain(results).collect(),
        }
    }
}

impl Plan {
    /// Creates a plan of these parameters, the first one varying slowest.
    ///
    /// # Errors
    /// If there is no parameter, a variable appears twice, there are no runs or more than 10^9, or
    /// several draws without a random parameter.
    pub fn new(seed: u64, draws: u64, parameters: Vec<Parameter>) -> Result<Self, Error> {
        if parameters.is_empty() {
            return Err(Error::new(
                "no parameter, expected at least one [[parameter]]",
            ));
        }
        let mut variables = HashSet::new();
        for variable in parameters.iter().flat_map(Parameter::variables) {
            if !variables.insert(variable) {
                return Err(Error::new(format!(
                    "{variable} appears twice, expected it in one parameter"
                )));
            }
        }
        if draws == 0 {
            return Err(Error::new("draws = 0, expected at least 1"));
        }
        if draws > 1 && parameters.iter().all(|parameter| !parameter.is_random()) {
            return Err(Error::new(format!(
                "draws = {draws}, expected a random parameter: uniform, log_uniform or normal"
            )));
        }
        let runs = parameters
            .iter()
            .try_fold(draws, |runs, parameter| runs.checked_mul(parameter.count()))
            .filter(|&runs| runs <= MAX_RUNS)
            .ok_or_else(|| {
                Error::new(format!(
                    "the plan has too many runs, expected {MAX_RUNS} at most"
                ))
            })?;
        Ok(Self {
            seed,
            draws,
            parameters,
            runs,
        })
    }

    /// The number of runs, from 1 to 10^9.
    #[must_use]
    pub fn runs(&self) -> u64 {
        self.runs
    }

    /// A column for every variable, in the order of the plan.
    #[must_use]
    pub fn columns(&self) -> Vec<Column> {
        let columns = |parameter: &'_ Parameter| {
            let kind = parameter.kind();
            let column = move |name: &String| Column {
                name: name.clone(),
                kind,
                optional: false,
            };
            parameter.variables().iter().map(column).collect::<Vec<_>>()
        };
        self.parameters.iter().flat_map(columns).collect()
    }

    /// The run with an index, from 0. It can be computed without the runs before it.
    ///
    /// A random number depends on the seed, the index of the draw and the rank of its parameter among
    /// the random ones. All grid points use the same draws, so that differences between two points are
    /// not due to the draws.
    ///
    /// # Errors
    /// If the plan has no run with this index.
    pub fn run(&self, index: u64) -> Result<Run<'_>, Error> {
        self.check(index..index.saturating_add(1))?;
        let draw = index % self.draws;
        let mut point = index / self.draws;
        let mut points_left = self.runs / self.draws;
        let mut rank = 0;
        let mut assignments = Vec::with_capacity(self.parameters.len());
        for parameter in &self.parameters {
            points_left /= parameter.count();
            let place = point / points_left;
            point %= points_left;
            let value = parameter.value(place, || draw::Draw {
                seed: self.seed,
                rank,
                draw,
            });
            rank += u64::from(parameter.is_random());
            for variable in parameter.variables() {
                assignments.push((variable.as_str(), value.clone()));
            }
        }
        Ok(Run { index, assignments })
    }

    /// Runs that together cover every listed value and both ends of every range, to be tried before a
    /// long sweep is started.
    #[must_use]
    pub fn corners(&self) -> Vec<u64> {
        let mut corners = vec![0];
        let mut runs = self.runs;
        for parameter in &self.parameters {
            runs /= parameter.count();
            corners.extend(parameter.corners().map(|place| place * runs));
        }
        corners
    }

    /// Checks that a range of runs, such as the share of a worker, is within the plan.
    ///
    /// # Errors
    /// If it is not, or is empty.
    pub fn check(&self, range: Range<u64>) -> Result<(), Error> {
        if range.start < range.end && range.end <= self.runs {
            return Ok(());
        }
        Err(Error::new(format!(
            "runs {}..{}, expected a range within 0..{}",
            range.start, range.end, self.runs
        )))
    }
}

#[cfg(test)]
mod tests;
