//! Systems as packages for other tools, by System Structure and Parameterization (SSP) 1.0.

mod layout;
mod package;
mod resources;
mod structure;
mod xml;

pub use package::Package;
