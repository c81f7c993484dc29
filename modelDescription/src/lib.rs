//! Model descriptions of FMI 2.0.4.
//!
//! A model declares its interface once, as a table of [`Variable`]s: names, units, starts, bounds,
//! causality, and where each value is stored in the model. The FMU binary accesses values through
//! the table, [`guid`](guid::guid) identifies it, and [`describe`] generates `modelDescription.xml`
//! from it, so the three cannot drift apart.
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
//!
//! The feature `xml` adds reading the model descriptions of FMUs from any vendor: `xml::parse`
//! returns a tree of elements, and `ModelDescription` is a typed view of it.
#![forbid(unsafe_code)]

mod describe;
pub mod guid;
#[cfg(feature = "xml")]
pub mod model;
pub mod unit;
#[cfg(feature = "xml")]
pub mod value;
mod variable;
mod vocabulary;
pub mod xml;

pub use describe::{Subject, describe};
#[cfg(feature = "xml")]
pub use model::{ModelDescription, ScalarVariable, Unknown};
pub use unit::Unit;
pub use variable::{
    DirectionalDerivative, Domain, Enumeration, Info, Start, ValueMut, Variable, check,
};
pub use vocabulary::{Capability, Causality, Initial, Variability, VariableType};
