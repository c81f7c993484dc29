//! A native master for FMUs of FMI 2.0 and 3.0 from any vendor, for co-simulation and model exchange, also in one
//! system.
//!
//! A [`Description`], usually read from a TOML file, lists the FMUs of a system and their connections.
//! A [`Plan`] loads the FMUs and checks that everything fits. A [`Simulation`] is one run of a plan.
//!
//! ```no_run
//! use fmu_master::{Description, Messages, Plan};
//!
//! let file = std::path::Path::new("examples/closed-loop/pid.toml");
//! let plan = Plan::new(&Description::read(file)?)?;
//! let mut largest: f64 = 0.0;
//! let angle = plan.place("plant.theta")?;
//! plan.simulate(&[], &Messages::default())?.run(|row| {
//!     largest = largest.max(row.number(angle).abs());
//!     true
//! })?;
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
//! - [`Order::Implicit`] (strong coupling): as in sequential order, but components that feed each other repeat their step
//!   until its inputs are the outputs after it.
//!
//! # Rows
//!
//! For a continuous component, the row of t(k) = start + k step contains the outputs at t(k), before
//! the step. For a sampled component (all its outputs are discrete), it contains the outputs of the sample
//! taken at t(k), which are available after the step. The last row belongs to the stop time.
//!
//! The outputs of a component are read once, after its step. If that fails, the run ends at the
//! communication point from which the component has stepped.
#![forbid(unsafe_code)]

mod access_list;
mod activations;
mod adaptive_plan;
mod algebraic_loop;
mod batches;
mod clocked_component;
mod clocked_stage;
mod code;
mod compilation;
mod component_clocks;
mod component_instance;
mod component_state;
mod components;
mod connections;
pub mod container;
mod crew;
pub mod curve;
mod cycle;
mod declarations;
mod description;
mod error;
mod event_mode;
mod execution;
mod experiment;
mod expose;
mod extrapolation;
mod fault;
mod fmu;
mod function;
mod given_inputs;
mod histogram;
mod input_table;
mod integrator;
mod iterated_group;
pub mod job;
mod literal;
mod live_input;
mod messages;
mod note;
mod observation;
mod observers;
mod overrides;
mod pace;
mod package;
mod plan;
mod profile;
mod quasi_newton;
mod random;
mod rate;
mod recorded_instance;
mod references;
pub mod run;
mod saved_run;
mod scheduled_component;
mod similar;
mod simulation;
mod solver;
pub mod ssp;
mod start;
mod step_control;
pub mod stepped_fmu;
mod stimuli;
mod store;
mod summary;
pub mod sweep;
mod system_file;
pub mod table;
mod table_inputs;
mod table_parameters;
mod terminals;
mod ticks;
pub mod trace;
pub mod vector;
mod wiring;

pub use compilation::Compilation;
pub use components::{Components, LoadedComponent};
pub use description::{
    AlgebraicLoops, Component, Connection, Conversion, Description, Order, Sandbox,
};
pub use error::{FailedCall, RunError};
pub use execution::{Execution, check_factor};
pub use experiment::Experiment;
pub use expose::Expose;
pub use fault::Fault;
pub use fmu::Fmu;
pub use fmu_host::InterfaceType;
pub use function::{Argument, Compute, Computed, Function, FunctionCall, Signature};
pub use given_inputs::{GivenInput, GivenInputs};
pub use literal::Literal;
pub use messages::{Level, Message, Messages};
pub use note::{Advice, Note, NoteOptions};
pub use observation::Observation;
pub use overrides::{Overrides, assignment};
pub use pace::{LongestStep, Moment, Punctuality};
pub use package::SystemOrigin;
pub use plan::Plan;
pub use profile::{FunctionTime, Profile};
pub use rate::{ComponentStep, Inputs};
pub use simulation::{Row, Simulation, Snapshot};
pub use solver::Solver;
pub use start::StartValue;
pub use step_control::AdaptiveSteps;
pub use stimuli::Stimuli;
pub use store::Place;
pub use summary::{Alarm, AlarmKind, Statistics, Summary};
pub use system_file::{is_fmu, locate};
pub use table::Column;
