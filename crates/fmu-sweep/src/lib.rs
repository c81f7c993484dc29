//! Parameter sweeps: a [`Plan`] defines the parameters of every run, [`Metrics`] reduces each run to a row
//! of numbers, and a [`Journal`] stores the rows so that they survive a kill and writes them as a CSV or
//! Parquet table. These three serve any simulation; a [`Study`] runs a system of FMUs in worker processes.
//!
//! The same plan produces the same table, byte for byte, for any number of threads, processes and
//! machines, provided that a simulation is deterministic.
//!
//! ```
//! use fmu_sweep::{Columns, Journal, Metrics, Options, Plan, Sample, Summary, Value};
//!
//! let plan: Plan = toml::from_str(
//!     "[[parameter]]
//!      variable = 'decay.T'
//!      values = [0.1, 0.2]",
//! )?;
//! let folder = tempfile::tempdir()?;
//! let output = folder.path().join("decay.csv");
//! let columns = Columns::new(plan.columns().into_iter().chain(Summary::columns()))?;
//! let journal = Journal::open(&output, "d3adb3ef", columns, plan.runs())?;
//!
//! for index in journal.pending(0..plan.runs()) {
//!     let run = plan.run(index)?;
//!     let Value::Number(constant) = run.assignments[0].1 else {
//!         unreachable!("the plan has numbers")
//!     };
//!     let mut metrics = Metrics::new(&Options::default());
//!     for k in 0..1000 {
//!         let time = 0.001 * f64::from(k);
//!         let y = 1.0 - libm::exp(-time / constant);
//!         metrics.push(Sample { time, r: 1.0, y, e: 1.0 - y, u: 1.0 });
//!     }
//!     journal.append(&run.row(metrics.finish().cells()))?;
//! }
//! journal.finish()?;
//! assert!(std::fs::read_to_string(output)?.starts_with("index,decay.T,iae,ise,itae,"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod channel;
mod error;
pub mod journal;
pub mod metrics;
pub mod plan;
mod row;
mod study;
pub mod table;
mod workers;

pub use error::Error;
pub use journal::Journal;
pub use metrics::{Metrics, Options, Sample, Summary};
pub use plan::{Parameter, Plan, Run};
pub use row::{Cell, Column, Columns, Kind, Row, Value};
pub use study::{Ended, FAILURE, Outline, Progress, Study};
pub use workers::Workers;
