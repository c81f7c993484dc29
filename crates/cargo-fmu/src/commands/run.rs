//! The commands that run FMUs.

use std::io::Write;
use std::process::ExitCode;

use anyhow::Result;
use clap::Subcommand;

use super::{compare, simulate, ssp, sweep, try_out, validate};
use crate::session::Session;

/// A command that runs FMUs.
#[derive(Subcommand)]
pub enum Command {
    /// Check FMUs as an importer would, and run their binaries
    #[command(after_help = "Exit code: 1 if there is an error, 0 if there are only warnings.

Example:\n  cargo fmu validate target/fmu/*.fmu")]
    Validate(validate::ValidateArgs),
    /// Simulate a system of coupled FMUs
    #[command(after_help = "Examples:
  cargo fmu simulate examples/closed-loop/pid.toml --csv target/pid.csv
  cargo fmu simulate examples/closed-loop/pid-rbf.toml --order parallel \\
      --set controller.previous_sample_terms=false --set controller.rbf.eta=0.2")]
    Simulate(simulate::SimulateArgs),
    /// Build models quickly and simulate them, again after each change
    #[command(
        mut_arg("system", |arg| arg.value_name("MODEL or SYSTEM.toml").help(
            "Model of this workspace, or system file, whose FMUs are all of this workspace"
        )),
        mut_arg("fmus", |arg| arg.hide(true)),
        mut_arg("sandbox", |arg| arg.hide(true)),
        mut_arg("profile", |arg| arg.default_value("dev")),
        after_help = "The FMUs are for FMI 2.0, and are deleted at the end.

Examples:
  cargo fmu run Pendulum --set theta0=0.1 --stop 2
  cargo fmu run loop.toml --watch --plot loop.html"
    )]
    Run(try_out::RunArgs),
    /// Simulate a system with many parameter sets; write the metrics of each run
    #[command(after_help = "An interrupted sweep resumes when it is started again.

Example:
  cargo fmu sweep examples/sweep/gains.toml --out target/gains.csv")]
    Sweep(sweep::SweepArgs),
    /// Compare the results of two runs
    #[command(
        after_help = "Variables are compared at the times of the reference. Exit code: 1 if one differs.

Examples:
  cargo fmu compare target/first.csv target/second.csv
  cargo fmu compare target/first.csv target/second.csv --relative 1e-3 \\
      --hold controller.u --plot target/both.html"
    )]
    Compare(compare::CompareArgs),
    /// Export systems of coupled FMUs as SSP 1.0 packages for other tools
    #[command(
        after_help = "A package cannot specify the order of stepping; most tools step all components
in parallel.

Examples:
  cargo fmu ssp examples/ssp/*.toml
  cargo fmu ssp my-system.toml --out packages"
    )]
    Ssp(ssp::SspArgs),
    /// Run one test of a binary in its own process
    // Resembles no other command, which would be suggested for a misspelled one.
    #[command(hide = true, name = "__probe")]
    Probe,
}

/// Runs a command.
///
/// # Errors
/// See the commands.
pub fn run(command: Command, out: &mut impl Write) -> Result<ExitCode> {
    match command {
        Command::Validate(args) => {
            let _session = Session::end_when_interrupted()?;
            if !validate::run(&args, out)? {
                return Ok(ExitCode::FAILURE);
            }
        }
        Command::Simulate(args) => return simulate::run(&args, out),
        Command::Run(args) => return try_out::run(args, out),
        Command::Sweep(args) => return sweep::run(&args, out),
        Command::Compare(args) => {
            let _session = Session::end_when_interrupted()?;
            if !compare::run(&args, out)? {
                return Ok(ExitCode::FAILURE);
            }
        }
        Command::Ssp(args) => {
            let _session = Session::end_when_interrupted()?;
            ssp::run(&args, out)?;
        }
        Command::Probe => fmu_check::probe()?,
    }
    Ok(ExitCode::SUCCESS)
}
