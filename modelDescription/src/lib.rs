//! What a model tells the world.
//!
//! A model declares its interface once, as a table of [`Variable`]s: names, units, starts, bounds,
//! causality, and where each value lives in the model. The FMU binary reads and writes values
//! through the table, [`guid`](guid::guid) identifies it, and with the feature `xml` the
//! `modelDescription.xml` of FMI 2.0.4 is written from it. So they cannot drift.
//!
//! ```
//! use fmu_description::{Variable, unit};
//!
//! #[derive(Default)]
//! struct Gain { u: f64, y: f64, k: f64 }
//!
//! type Row = Variable<Gain>;
//! const VARIABLES: &[Row] = &[
//!     Row::input("u", |m| &mut m.u).unit(unit::NEWTON).about("force"),
//!     Row::output("y", |m| &mut m.y).unit(unit::NEWTON).about("amplified force"),
//!     Row::tunable("k", 2.0, |m| &mut m.k).at_least(0.0).about("gain"),
//! ];
//! # assert_eq!(VARIABLES.len(), 3);
//! ```
#![forbid(unsafe_code)]

#[cfg(feature = "xml")]
mod describe;
pub mod guid;
#[cfg(feature = "xml")]
pub mod schema;
pub mod unit;
mod variable;

#[cfg(feature = "xml")]
pub use describe::{Subject, describe};
pub use unit::Unit;
pub use variable::{
    Causality, Domain, Enumeration, Info, Place, Sensitivity, Start, Variability, Variable, check,
};
