//! A native master for co-simulation FMUs of FMI 2.0 and 3.0 from any vendor, also in one system.
//!
//! A [`Description`], usually read from a TOML file, lists the FMUs of a system and their connections.
//! A [`Plan`] loads the FMUs and checks that everything fits. A [`Simulation`] is one run of a plan.
//!
//! ```no_run
//! use fmu_cosim::{Description, Plan};
//!
//! let file = std::path::Path::new("examples/closed-loop/pid.toml");
//! let plan = Plan::new(&Description::read(file)?)?;
//! let mut largest: f64 = 0.0;
//! plan.simulate(&[])?.run(|_time, row| largest = row.iter().fold(largest, |a, b| a.max(b.abs())))?;
//! # anyhow::Ok(())
//! ```
//!
//! # Orders of stepping
//!
//! At each communication point t the components step to t + h:
//!
//! - [`Order::Sequential`] (Gauss-Seidel): one after the other, in the order of the description; each
//!   first fetches its inputs from the newest outputs.
//! - [`Order::Parallel`] (Jacobi): all outputs are read, all inputs are set, then all components step.
//!
//! # Rows
//!
//! For a continuous component, the row of t(k) = start + k step contains the outputs at t(k), before
//! the step. For a sampled component (all its outputs are discrete), it contains those of the sample
//! taken at t(k), which are available after the step. The last row is that of the stop time.
//!
//! The outputs of a component are read once, after its step. If that fails, the run ends at the
//! communication point from which the component has stepped.
#![forbid(unsafe_code)]

mod access;
mod check;
mod csv;
mod description;
mod fmu;
mod instance;
mod locate;
mod messages;
mod plan;
mod recorder;
mod simulation;
pub mod ssp;
mod supervised;
mod system;
mod transfer;
mod value;
mod wiring;

pub use csv::{Csv, Kept};
pub use description::{Component, Connection, Description, Experiment, Order, Scale};
pub use fmu::{Fmu, Variable};
pub use instance::Failure;
pub use locate::locate;
pub use messages::{Message, Messages};
pub use plan::{Column, Plan, Start};
pub use recorder::Recorder;
pub use simulation::Simulation;
pub use supervised::Supervised;
pub use system::Planned;
pub use value::{Typed, Value};
