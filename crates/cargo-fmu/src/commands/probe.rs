//! `cargo fmu probe`: one test of a binary, in a process of its own; `validate` starts it.

use std::ffi::OsString;

use clap::Args;

/// Name of the command.
pub const NAME: &str = "probe";

/// What `fmu_check` passes to itself.
#[derive(Debug, Args)]
pub struct ProbeArgs {
    #[arg(hide = true)]
    arguments: Vec<OsString>,
}

/// Makes the test.
///
/// # Errors
/// The arguments are not those of a test; the unpacked FMU cannot be read.
pub fn run(args: &ProbeArgs) -> anyhow::Result<()> {
    fmu_check::probe(&args.arguments)
}
