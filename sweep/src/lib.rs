//! Parameter sweeps of simulations, whatever simulates.

#![forbid(unsafe_code)]

mod error;
pub mod journal;
pub mod metrics;
pub mod plan;
mod row;
pub mod table;

pub use error::Error;
pub use journal::Journal;
pub use metrics::{Metrics, Options, Sample, Summary};
pub use plan::{Parameter, Plan, Run};
pub use row::{Cell, Column, Columns, Kind, Row, Value};
