//! The command line `cargo fmu`.
#![forbid(unsafe_code)]

pub mod commands;
// Without the commands that run FMUs, a part of both is not used.
#[cfg(feature = "run")]
mod plot;
pub mod session;
#[cfg_attr(not(feature = "run"), expect(dead_code))]
mod style;
mod table;

use std::ffi::OsString;
use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

use session::Session;
use style::ERROR;

#[cfg(feature = "run")]
use commands::run;
use commands::{completions, export, info, merge, new};

/// Write, build, inspect, merge, check, simulate and sweep FMUs
#[derive(Parser)]
#[command(name = "cargo-fmu", bin_name = "cargo fmu", version, max_term_width = 80)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Write a new package with a controller and a plant
    #[command(
        after_help = "The package contains a test, a closed loop for `cargo fmu simulate`, and a
workflow that builds FMUs for Linux, Windows and macOS. In a workspace, it
becomes a member.

Example:\n  cargo fmu new my-controller"
    )]
    New(new::NewArgs),
    /// Build the models of this workspace into FMUs
    #[command(after_help = "Examples:
  cargo fmu export                     all models for this machine, to target/fmu
  cargo fmu export Pid --out fmus      one model, to another folder
  cargo fmu export --portable          for any Linux with glibc 2.17 or newer
  cargo fmu export --portable --target x86_64-pc-windows-gnu \\
      --target universal2-apple-darwin for Linux, Windows and macOS
  cargo fmu export Pid --binary win64=fmu_controller.dll
                                       with a binary built elsewhere
  cargo fmu export Pid --name FastPid --set pid.kp=400 --set ts=0.0005
                                       a variant with other start values")]
    Export(fmu_build::Options),
    /// Show the variables, capabilities and platforms of FMUs
    #[command(after_help = "Example:\n  cargo fmu info target/fmu/Pid.fmu")]
    Info(info::InfoArgs),
    /// Merge FMUs of one model that were built on different machines
    #[command(
        after_help = "The FMUs must be built from the same version of the model, and files that
several of them contain must be equal. Only documentation may differ; the first
FMU's is kept.

Examples:
  cargo fmu merge linux/Pid.fmu windows/Pid.fmu -o Pid.fmu
  cargo fmu merge Pid.fmu macos/Pid.fmu -o Pid.fmu"
    )]
    Merge(merge::MergeArgs),
    #[cfg(feature = "run")]
    #[command(flatten)]
    Run(run::Command),
    /// Print a completion script for a shell
    #[command(after_help = "Example:
  source <(cargo fmu completions bash)")]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// Runs the command line with these arguments, the first of which is the name of the program. To run foreign
/// code in other processes, it is started again: by `program` and the other arguments; if `program` is empty, it
/// is the program of this process.
pub fn main(program: Vec<OsString>, arguments: impl Iterator<Item = OsString>) -> ExitCode {
    let arguments = Vec::from_iter(arguments);
    session::started(program, arguments.iter().skip(1).cloned().collect());
    match run(Cli::parse_from(without_subcommand(arguments.into_iter())).command) {
        Ok(code) => code,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Messages of the TOML parser already end with a line feed.
            let text = format!("{error:#}");
            tell(format_args!("{ERROR}error:{ERROR:#} {}", text.trim_end()));
            ExitCode::FAILURE
        }
    }
}

/// Writes a line for people to the standard error output, which somebody may have closed.
fn tell(line: fmt::Arguments<'_>) {
    let _ = writeln!(anstream::stderr(), "{line}");
}

/// The arguments without the name of the subcommand, which cargo repeats to an installed `cargo-fmu`.
fn without_subcommand(all: impl Iterator<Item = OsString>) -> impl Iterator<Item = OsString> {
    all.enumerate()
        .filter(|(index, argument)| *index != 1 || argument != "fmu")
        .map(|(_, argument)| argument)
}

fn run(command: Command) -> anyhow::Result<ExitCode> {
    // Not locked, since a sweep prints rows from several threads.
    let out = &mut anstream::stdout();
    match command {
        Command::New(args) => new::run(&args, out)?,
        Command::Export(options) => {
            let _session = Session::end_when_interrupted()?;
            export::run(&options, out)?;
        }
        Command::Info(args) => info::run(&args, out)?,
        Command::Merge(args) => {
            let _session = Session::end_when_interrupted()?;
            merge::run(&args, out)?;
        }
        #[cfg(feature = "run")]
        Command::Run(command) => return run::run(command, out),
        Command::Completions { shell } => {
            out.write_all(&completions::script(shell, Cli::command()))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Whether the reader of our output has exited, as in `cargo fmu info FILE | head`.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
