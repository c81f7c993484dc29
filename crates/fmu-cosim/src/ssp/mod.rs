//! Systems as packages for other tools, by System Structure and Parameterization (SSP) 1.0.

mod layout;
mod package;
mod resources;
mod structure;

pub use package::Package;
