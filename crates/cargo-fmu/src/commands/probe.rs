//! `cargo fmu probe`: one test of a binary in its own process, started by `validate`.

use std::ffi::OsString;

use clap::Args;

/// Name of the command.
pub const NAME: &str = "probe";

/// The arguments that `fmu_check` passes to itself.
#[derive(Debug, Args)]
pub struct ProbeArgs {
    #[arg(hide = true)]
    arguments: Vec<OsString>,
}

/// Runs the test.
///
/// # Errors
/// The arguments do not describe a test, or the unpacked FMU cannot be read.
pub fn run(args: &ProbeArgs) -> anyhow::Result<()> {
    fmu_check::probe(&args.arguments)
}
