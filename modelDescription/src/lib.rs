//! Model descriptions of FMI 2.0.5 and 3.0.2.
//!
//! A model declares its interface once: `#[derive(Model)]` of the crate `fmu-export` turns the fields of
//! a struct into a table of [`TableRow`]s (names, units, starts, bounds, causality) and the access to their
//! values ([`Variables`]). The FMU binary checks and accesses values through the table, a [`hash`] of
//! it is the GUID, and a copy of it in the binary becomes the `modelDescription.xml`, so that the three
//! cannot drift apart.
//!
//! Without the feature `table`, which is on by default, there is only the vocabulary of the derive macros. The feature
//! `xml` adds reading and writing model descriptions, also of FMUs from any vendor:
//! `xml::parse` returns a tree of elements, and `ModelDescription` is a typed view of it.
#![deny(unsafe_code)]

#[cfg(feature = "table")]
mod change;
#[cfg(feature = "xml")]
pub mod changes;
#[cfg(feature = "table")]
pub mod checks;
#[cfg(feature = "table")]
mod clock;
mod clock_type;
#[cfg(feature = "table")]
#[doc(hidden)]
pub mod derive;
#[cfg(feature = "xml")]
mod describe;
#[cfg(feature = "xml")]
mod embedded;
#[cfg(feature = "xml")]
mod exported;
#[cfg(feature = "xml")]
mod fmi2;
#[cfg(feature = "xml")]
mod fmi3;
#[cfg(feature = "table")]
pub mod hash;
#[cfg(feature = "table")]
pub mod interface;
pub mod location;
#[cfg(feature = "xml")]
mod mime_type;
#[cfg(feature = "xml")]
pub mod model;
mod naming;
mod number;
#[cfg(feature = "table")]
pub mod references;
#[cfg(feature = "table")]
pub mod scalar;
#[cfg(feature = "table")]
mod state;
#[cfg(feature = "table")]
pub mod table;
#[cfg(feature = "xml")]
mod terminals;
pub mod unit;
pub mod value;
#[cfg(feature = "xml")]
mod variable;
#[cfg(feature = "table")]
mod variables;
mod vocabulary;
pub mod words;
#[cfg(feature = "xml")]
pub mod xml;

#[cfg(feature = "table")]
pub use clock::{Clock, Timing};
pub use clock_type::ClockType;
#[cfg(feature = "xml")]
pub use describe::Origin;
#[cfg(feature = "xml")]
pub use embedded::{erase_interfaces, read_interfaces};
#[cfg(feature = "xml")]
pub use exported::ExportedModel;
pub use fmi_abi::{FmiVersion, InterfaceType};
#[cfg(feature = "table")]
pub use interface::{Interface, StartOverrides};
#[cfg(feature = "xml")]
pub use mime_type::MimeType;
#[cfg(feature = "xml")]
pub use model::{ModelDescription, Unknown, XmlVariable};
pub use number::Number;
#[cfg(feature = "table")]
pub use scalar::ScalarVariable;
#[cfg(feature = "table")]
pub use state::{StateError, StateReader, StateWriter};
#[cfg(feature = "table")]
pub use table::{AnyChoice, Dynamics, TableRow};
pub use unit::Unit;
pub use value::Value;
#[cfg(feature = "xml")]
pub use variable::{DeclaredType, EnumerationItem, ExportInfo, Variable};
#[cfg(feature = "table")]
pub use variables::{Choice, Variables};
pub use vocabulary::{
    Causality, Initial, IntervalVariability, LogCategory, Naming, OwnCategory, Type, Variability,
};
