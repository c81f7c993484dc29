//! `cargo fmu ssp`: systems as packages for other tools, by System Structure and Parameterization 1.0.

#[cfg(feature = "master")]
mod layout;
#[cfg(feature = "master")]
mod package;
#[cfg(feature = "master")]
mod resources;
#[cfg(feature = "master")]
mod structure;
#[cfg(feature = "master")]
mod xml;

use std::path::PathBuf;

use clap::Args;

/// What to package, and where it goes.
#[derive(Args)]
pub struct Options {
    /// Files that describe systems; without any, the loops of examples/ssp with the FMUs of target/fmu
    #[arg(value_name = "SYSTEM.toml")]
    pub systems: Vec<PathBuf>,
    /// Folder that the packages are written to
    #[arg(long, value_name = "DIR", default_value = "target/fmu")]
    pub out: PathBuf,
    /// Folder to take the FMUs from, in place of those of the files
    #[arg(long, value_name = "DIR")]
    pub fmus: Option<PathBuf>,
}

#[cfg(feature = "master")]
pub use package::run;
