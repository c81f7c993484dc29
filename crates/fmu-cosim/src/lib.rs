//! A native master for FMI 2.0 co-simulation FMUs from any vendor.
//!
//! A [`Description`] says which FMUs a system is made of and which output feeds which input; a TOML
//! file holds one. A [`Plan`] loads the FMUs and checks that everything fits. A [`Simulation`] is one
//! run of it.
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
//! - [`Order::Sequential`] (Gauss-Seidel): one after the other, each after it has fetched its inputs
//!   from the newest outputs. The order is that of the description.
//! - [`Order::Parallel`] (Jacobi): all outputs are read, all inputs are set, then all components step.
//!
//! # What a row holds
//!
//! The row of t(k) = start + k step holds, of a component that computes continuously, the outputs at
//! t(k), before the step; of a sampled one (all its outputs are discrete), those of the sample that it
//! takes at t(k), which it shows after the step. The last row is that of the stop time.
#![forbid(unsafe_code)]

mod check;
mod csv;
mod description;
mod fmu;
mod instance;
mod messages;
mod plan;
mod simulation;
pub mod ssp;
mod system;
mod transfer;
mod value;
mod wiring;

pub use csv::Csv;
pub use description::{Component, Connection, Description, Experiment, Order};
pub use fmu::{Fmu, Variable};
pub use instance::Failure;
pub use messages::{Message, Messages};
pub use plan::{Column, Plan, Start};
pub use simulation::Simulation;
pub use system::Planned;
pub use value::{Typed, Value};
