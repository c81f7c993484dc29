//! Exports systems as System Structure and Parameterization (SSP) 1.0 packages.

mod layout;
mod names;
mod package;
mod resources;
mod structure;

pub use package::Package;
