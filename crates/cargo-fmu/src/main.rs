//! `cargo fmu`: builds the models of a workspace into FMUs, looks into FMUs, joins and checks them.
#![forbid(unsafe_code)]

mod binary;
mod build;
mod completions;
mod documentation;
mod export;
#[cfg(test)]
mod fuzz;
mod info;
mod library;
mod master;
mod merge;
mod table;
mod toolchain;
mod validate;

use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

/// Builds models into FMUs (FMI 2.0 co-simulation), looks into FMUs, joins and checks them.
#[derive(Parser)]
#[command(name = "cargo-fmu", bin_name = "cargo fmu", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Build the models of this workspace and write an FMU of each
    #[command(after_help = "Examples:
  cargo fmu export                          all models, for this machine, to target/fmu
  cargo fmu export Pid Pendulum --out fmus  two of them, to another folder
  cargo fmu export --portable               for every Linux with glibc 2.17 or newer
  cargo fmu export --portable --target x86_64-pc-windows-gnu --target universal2-apple-darwin
                                            for Linux, Windows and macOS
  cargo fmu export --target aarch64-unknown-linux-gnu.2.17 --out aarch64
                                            for Linux on ARM
  cargo fmu export Pid --binary win64=fmu_controller.dll
                                            with a binary that was built elsewhere")]
    Export(export::Options),
    /// Show what is in an FMU: variables, capabilities, platforms
    #[command(after_help = "Example:\n  cargo fmu info target/fmu/Pid.fmu")]
    Info {
        /// The FMU, of any maker
        file: PathBuf,
    },
    /// Join FMUs of one model that were built on several machines
    #[command(
        after_help = "The FMUs must be of one version of the model. A file that several have must be the same in all of
them; only where it is documentation, that of the first is taken.

Examples:
  cargo fmu merge linux/Pid.fmu windows/Pid.fmu -o Pid.fmu
  cargo fmu merge Pid.fmu macos/Pid.fmu -o Pid.fmu
                                            adds to an FMU what another one has"
    )]
    Merge(merge::Options),
    /// Check FMUs as an importer would, and run their binaries
    #[command(
        after_help = "Exit code: 1 if there is an error, 0 if there are warnings at most.

Example:\n  cargo fmu validate target/fmu/*.fmu"
    )]
    Validate(validate::Options),
    /// Simulate a system of coupled FMUs by the native master
    #[command(after_help = "Examples:
  cargo fmu simulate examples/closed-loop/pid.toml --csv target/pid.csv
  cargo fmu simulate examples/closed-loop/pid-rbf.toml --order parallel \\
      --set controller.previous_sample_terms=false --set controller.rbf.eta=0.2")]
    Simulate(master::simulate::Options),
    /// Compute the paper's Table 1 by the native master
    #[command(after_help = "Exit code: 1 if a number is missed.")]
    Table1(master::table1::Options),
    /// Run a system thousands of times, each with other values, and write metrics of each run
    #[command(
        after_help = "A sweep that was killed goes on where it was when it is started again.

Example:
  cargo fmu sweep examples/sweep/gains.toml --out target/gains.csv"
    )]
    Sweep(master::sweep::Options),
    /// Write systems of coupled FMUs as packages for other tools (SSP 1.0)
    #[command(
        after_help = "A package does not say in which order a tool steps; most step all components in parallel.

Examples:
  cargo fmu ssp                             the loops of examples/ssp, to target/fmu
  cargo fmu ssp my-system.toml --out packages"
    )]
    Ssp(master::ssp::Options),
    /// One test of a binary, in a process of its own
    #[command(hide = true)]
    Probe(validate::probe::Options),
    /// Print the completions of a shell for this command
    #[command(after_help = "Example:
  source <(cargo fmu completions bash)")]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

fn main() -> ExitCode {
    match run(Cli::parse_from(arguments(std::env::args_os())).command) {
        Ok(code) => code,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Messages of the parser of TOML end with a line feed of their own.
            eprintln!("error: {}", format!("{error:#}").trim_end());
            ExitCode::FAILURE
        }
    }
}

/// The arguments without the name of the subcommand, which cargo repeats to an installed `cargo-fmu`.
fn arguments(all: impl Iterator<Item = OsString>) -> impl Iterator<Item = OsString> {
    all.enumerate()
        .filter(|(index, argument)| *index != 1 || argument != "fmu")
        .map(|(_, argument)| argument)
}

fn run(command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Export(options) => export::export(&options)?,
        Command::Info { file } => info::print(&file, &mut io::stdout().lock())?,
        Command::Merge(options) => merge::merge(&options)?,
        Command::Validate(options) => {
            if !validate::validate(&options, &mut io::stdout().lock())? {
                return Ok(ExitCode::FAILURE);
            }
        }
        #[cfg(feature = "master")]
        Command::Simulate(options) => master::simulate::run(&options, &mut io::stdout().lock())?,
        #[cfg(feature = "master")]
        Command::Table1(options) => {
            if !master::table1::run(&options, &mut io::stdout().lock())? {
                return Ok(ExitCode::FAILURE);
            }
        }
        #[cfg(feature = "master")]
        Command::Sweep(options) => master::sweep::run(&options, &mut io::stdout())?,
        #[cfg(feature = "master")]
        Command::Ssp(options) => master::ssp::run(&options, &mut io::stdout().lock())?,
        #[cfg(not(feature = "master"))]
        Command::Simulate(_) | Command::Table1(_) | Command::Sweep(_) | Command::Ssp(_) => {
            return master::forward::forward(std::env::args_os().skip(1));
        }
        Command::Probe(options) => validate::probe::run(&options)?,
        Command::Completions { shell } => {
            let script = completions::script(shell, Cli::command());
            io::Write::write_all(&mut io::stdout(), &script)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Whether the reader of our output has gone, as in `cargo fmu info FILE | head`.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<io::Error>()
        .is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
