//! Model descriptions of FMI 2.0.5 and 3.0.2.
//!
//! A model declares its interface once: `#[derive(Model)]` of the crate `fmu-export` turns the fields of
//! a struct into a table of [`Row`]s (names, units, starts, bounds, causality) and the access to their
//! values ([`Variables`]). The FMU binary checks and accesses values through the table,
//! [`guid`](guid::guid) identifies it, and a copy of it in the binary ([`embedded`]) becomes the
//! `modelDescription.xml` ([`Description::to_xml_of`]), so that the three cannot drift apart.
//!
//! The feature `xml` adds reading and writing model descriptions, also those of FMUs from any vendor:
//! `xml::parse` returns a tree of elements, and `ModelDescription` is a typed view of it.
#![deny(unsafe_code)]

#[cfg(feature = "xml")]
mod describe;
pub mod embedded;
pub mod guid;
pub mod interface;
#[cfg(feature = "xml")]
pub mod model;
pub mod table;
pub mod unit;
#[cfg(feature = "xml")]
pub mod value;
mod variables;
mod vocabulary;
pub mod words;
pub mod xml;

#[cfg(feature = "xml")]
pub use describe::{Description, FmiVersion, Origin, Type, VariableDescription};
#[cfg(feature = "xml")]
pub use embedded::read as read_interfaces;
pub use interface::{Hexadecimal, Interface, Overrides, StartValue};
#[cfg(feature = "xml")]
pub use model::{ModelDescription, ScalarVariable, Unknown};
pub use table::{Domain, Dynamics, Enumeration, Integers, Item, Reals, Row, Scalar, Variable};
pub use unit::Unit;
#[doc(hidden)]
pub use variables::derive;
pub use variables::{AnyChoice, Choice, Damaged, Loader, Saver, Value, ValueMut, Variables};
pub use vocabulary::{
    Capability, Causality, Initial, IntegerKind, LOG_CATEGORIES, Variability, VariableType,
};
