//! The command line `cargo fmu`.
#![forbid(unsafe_code)]

pub mod commands;
mod plot;
pub mod progress;
pub mod session;
mod template;
mod ui;
mod worker;

use std::ffi::OsString;
use std::io::{self, Write};
use std::process::ExitCode;

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};

use session::Session;

use commands::{
    build, compare, completions, diff, export, info, merge, new, pack, replay, run, simulate, ssp,
    sweep, validate,
};

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

Examples:\n  cargo fmu new my-controller\n  cargo fmu new my-controller --c"
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
  cargo fmu export --sources           with C sources, for other targets
  cargo fmu export Pid --name FastPid --set pid.kp=400 --set ts=0.0005
                                       a variant with other start values")]
    Export(fmu_build::ExportOptions),
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
    /// Compile the C or C++ sources of FMUs, and add the binary for this machine
    #[command(
        after_help = "The sources are compiled by their build description (FMI 3.0 and 2.0.4) or their list
of source files (FMI 2.0). The environment variables CC, CXX, CFLAGS and
CXXFLAGS choose the compiler and its options. Nothing that was compiled is run.

Examples:
  cargo fmu build BouncingBall.fmu
  cargo fmu build vendor/Motor.fmu --out Motor.fmu"
    )]
    Build(build::BuildArgs),
    /// Check FMUs as an importer would, and run their binaries
    #[command(after_help = "Exit code: 1 if there is an error, 0 if there are only warnings.

Example:\n  cargo fmu validate target/fmu/*.fmu")]
    Validate(validate::ValidateArgs),
    /// Simulate a system of coupled FMUs
    #[command(after_help = "Examples:
  cargo fmu simulate examples/closed-loop/pid.toml --csv target/pid.csv
  cargo fmu simulate examples/closed-loop/pid-rbf.toml --order parallel \\
      --set controller.previous_sample_terms=false --set controller.rbf.eta=0.2")]
    Simulate(simulate::ProfiledArgs),
    /// Build models quickly and simulate them, again after each change
    #[command(
        mut_arg("system", |arg| arg.value_name("MODEL or SYSTEM.toml").help(
            "Model of this workspace, or system file whose FMUs are all built from this workspace"
        )),
        mut_arg("fmus", |arg| arg.hide(true)),
        mut_arg("sandbox", |arg| arg.hide(true)),
        mut_arg("compile", |arg| arg.hide(true)),
        mut_arg("profile", |arg| arg.default_value("dev")),
        after_help = "The FMUs are for FMI 2.0, and are deleted at the end.

Examples:
  cargo fmu run Pendulum --set theta0=0.1 --stop 2
  cargo fmu run loop.toml --watch --plot loop.html"
    )]
    Run(run::RunArgs),
    /// Repeat the calls of a trace, and show the first difference
    #[command(
        after_help = "Exit code: 0 if the FMUs do the same as in the trace, 1 if one differs.

Examples:
  cargo fmu simulate loop.toml --trace loop.jsonl
  cargo fmu replay loop.jsonl                          with the same FMUs
  cargo fmu replay loop.jsonl new/Motor.fmu --component motor
                                                       with a new version
  cargo fmu replay loop.jsonl --component motor --c motor.c
                                                       as a C program
  cargo fmu replay loop.jsonl --print"
    )]
    Replay(replay::ReplayArgs),
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
    /// Show what importers have to change from one FMU to another
    #[command(
        after_help = "Exit code: 0 if all that works with the old FMU works with the new one, 1 if names
break, value references move or results may change, 2 if an FMU cannot be read.

Example:
  cargo fmu diff released/Pid.fmu target/fmu/Pid.fmu"
    )]
    Diff(diff::DiffArgs),
    /// Export systems of coupled FMUs as SSP packages for other tools
    #[command(
        after_help = "A package cannot specify the order of stepping; most tools step all components
in parallel.

Examples:
  cargo fmu ssp examples/ssp/*.toml
  cargo fmu ssp my-system.toml --out packages"
    )]
    Ssp(ssp::SspArgs),
    /// Make one FMU of a system, a container with the master inside
    #[command(after_help = "The master is built by cargo once, and kept in cargo's home folder.

Examples:
  cargo fmu pack examples/closed-loop/pid.toml -o Loop.fmu
  cargo fmu pack my-system.ssp --fmi 3.0")]
    Pack(pack::PackArgs),
    /// Be a worker process of another command
    // Resembles no other command, which would be suggested for a misspelled one.
    #[command(hide = true, name = worker::COMMAND)]
    Worker {
        /// The code that has started it
        supervisor: worker::Supervisor,
    },
    /// Print a completion script for a shell
    #[command(after_help = "Example:
  source <(cargo fmu completions bash)")]
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

/// Runs the command line with these arguments, the first of which is the name of the program. The words of `program`
/// start it again, as a worker process; if there are none, the program of this process does.
pub fn main(program: Vec<OsString>, arguments: impl Iterator<Item = OsString>) -> ExitCode {
    session::set_program(program);
    match execute(Cli::parse_from(without_subcommand(arguments)).command) {
        Ok(code) => code,
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            ui::error(&error);
            ExitCode::FAILURE
        }
    }
}

/// A template with the value of each placeholder, in which others are left as they are.
fn filled(mut template: &str, values: &[(&str, &str)]) -> String {
    let mut text = String::new();
    let first = |template: &str| {
        let found = values.iter().filter_map(|value| Some((template.find(value.0)?, *value)));
        found.min_by_key(|(start, _)| *start)
    };
    while let Some((start, (placeholder, value))) = first(template) {
        text.extend([&template[..start], value]);
        template = &template[start + placeholder.len()..];
    }
    text + template
}

/// The arguments without the name of the subcommand, which cargo repeats to an installed `cargo-fmu`.
fn without_subcommand(all: impl Iterator<Item = OsString>) -> impl Iterator<Item = OsString> {
    all.enumerate()
        .filter(|(index, argument)| *index != 1 || argument != "fmu")
        .map(|(_, argument)| argument)
}

fn execute(command: Command) -> Result<ExitCode> {
    // Not locked, since a sweep prints rows from several threads.
    let out = &mut anstream::stdout();
    let code = |is_passed| if is_passed { ExitCode::SUCCESS } else { ExitCode::FAILURE };
    match command {
        Command::New(args) => new::run(&args, out)?,
        Command::Export(mut options) => {
            // How the user can repeat it.
            let words = std::env::args_os().skip_while(|word| word != "export").skip(1);
            options.arguments = words.map(|word| word.to_string_lossy().into_owned()).collect();
            until_interrupted(|| export::run(&options, out))?;
        }
        Command::Info(args) => info::run(&args, out)?,
        Command::Merge(args) => until_interrupted(|| merge::run(&args, out))?,
        Command::Build(args) => return build::run(&args, out),
        Command::Validate(args) => {
            let session = Session::end_when_interrupted()?;
            return validate::run(&args, &session, out).map(code);
        }
        Command::Replay(args) => return replay::run(args, out),
        Command::Simulate(args) => return simulate::run(args, out),
        Command::Run(args) => return run::run(args, out),
        Command::Sweep(args) => return sweep::run(&args, out),
        Command::Compare(args) => return until_interrupted(|| compare::run(&args, out)).map(code),
        Command::Diff(args) => {
            let compared = until_interrupted(|| diff::run(&args, out)).map(code);
            return compared.or_else(|error| match is_broken_pipe(&error) {
                true => Err(error),
                false => {
                    ui::error(&error);
                    Ok(ExitCode::from(2))
                }
            });
        }
        Command::Pack(args) => until_interrupted(|| pack::run(args, out))?,
        Command::Ssp(args) => until_interrupted(|| ssp::run(&args, out))?,
        Command::Completions { shell } => {
            out.write_all(&completions::script(shell, Cli::command()))?;
        }
        Command::Worker { supervisor } => worker::main(supervisor)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Runs a command in a session that ends the process when it is interrupted.
fn until_interrupted<T>(work: impl FnOnce() -> Result<T>) -> Result<T> {
    let _session = Session::end_when_interrupted()?;
    work()
}

/// Whether the reader of our output has exited, as in `cargo fmu info FILE | head`.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_may_contain_placeholders() {
        assert_eq!(
            filled("a NAME, a PLACE", &[("PLACE", "NAME"), ("NAME", "PLACE")]),
            "a PLACE, a NAME"
        );
    }
}
