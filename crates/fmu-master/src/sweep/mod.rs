//! Parameter sweeps: many runs of one plan. [`Parameters`] has the values of every run, [`MetricsAccumulator`] reduces
//! each run to a row of numbers, and a [`Journal`] stores the rows so that they survive a kill and writes
//! them as a table. A [`Study`] does this for a system of FMUs, in worker processes.
//!
//! The same sweep produces the same table, byte for byte, for any number of processes and machines, provided
//! that a simulation is deterministic.

use anyhow::Result;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

mod journal;
mod metrics;
mod parameters;
mod pool;
mod study;

pub use journal::Journal;
pub use metrics::{Criteria, LoopSample, Metrics, MetricsAccumulator};
pub use parameters::{Parameter, Parameters};
pub use pool::Workers;
pub use study::{Outline, Study, SweepProgress};

/// Reads a value and converts it, so that an error names its line.
fn converted<'de, D: Deserializer<'de>, T: Deserialize<'de>, U>(
    deserializer: D,
    convert: impl FnOnce(T) -> Result<U>,
) -> Result<U, D::Error> {
    convert(T::deserialize(deserializer)?).map_err(D::Error::custom)
}
