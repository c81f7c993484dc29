//! Systems as System Structure and Parameterization (SSP) packages, versions 1.0 and 2.0, written and read.

mod arrays;
mod document;
mod parameter_set;
mod parameters;
mod read;
mod structure;
mod system;
mod vocabulary;
mod write;

pub use parameter_set::{SetParameter, parameter_set};
pub use read::read;
pub use write::Package;
