//! Parameter sweeps: many runs of one plan, each of which records a row of metrics.
//!
//! A [`Study`] is a sweep file (`file.rs`) applied to its system. In the order of a run: [`Parameters`] has the values of
//! every run; a worker process (`worker.rs`) simulates the run, reduces its signals (`signals.rs`) to [`Metrics`]
//! (`metrics.rs`), and makes its row (`row.rs`); the supervisor (`supervisor.rs`, `pool.rs`) stores the rows in a
//! [`Journal`], so that they survive a kill, and writes them as a table.
//!
//! A component that is a function runs in the supervisor, which makes the functions of each run anew.
//!
//! The same sweep produces the same table, byte for byte, for any number of processes and machines, provided
//! that a simulation is deterministic.

mod file;
mod journal;
mod metrics;
mod parameter;
mod parameters;
mod pool;
mod progress;
mod row;
mod signals;
mod study;
mod supervisor;
mod worker;

pub use file::SweepSource;
pub use journal::Journal;
pub use metrics::{Criteria, Metrics, MetricsAccumulator};
pub use parameter::Parameter;
pub use parameters::Parameters;
pub use pool::{RunFunctions, Workers, process_count};
pub use progress::SweepProgress;
pub use signals::LoopSample;
pub use study::Study;
pub use supervisor::Outline;
pub(crate) use worker::serve;
