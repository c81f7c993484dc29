//! Supervisor side of `cargo fmu replay`: repeats the calls of a trace in a worker process, or writes them as a C program.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use fmu_master::Compilation;
use fmu_master::job::{self, Job};
use fmu_master::table::Tolerance;
use fmu_master::trace::{
    self, Difference, ReplayEnd, ReplaySource, Replayed, print_calls, write_program,
};

use super::limits::Limited;
use crate::session::{self, Session};
use crate::ui;

/// The trace, and what to do with it.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Trace that `cargo fmu simulate --trace` has written
    #[arg(value_name = "TRACE")]
    trace: PathBuf,
    /// FMU to call instead of the one of the trace, such as a new version
    #[arg(value_name = "FMU")]
    fmu: Option<PathBuf>,
    /// Repeat the calls of this component only
    #[arg(long, value_name = "NAME")]
    component: Option<String>,
    /// Absolute tolerance of numbers, in the unit of the variable
    #[arg(long, value_name = "TOLERANCE", default_value = "1e-12")]
    absolute: f64,
    /// Tolerance relative to the number in the trace, which is added
    #[arg(long, value_name = "TOLERANCE", default_value = "1e-6")]
    relative: f64,
    /// Repeat nothing, but write a C program that makes the calls of the component and checks the results, for whoever
    /// has the FMU but not this program
    #[arg(long, value_name = "PROGRAM.c", conflicts_with_all = ["fmu", "print"])]
    c: Option<PathBuf>,
    /// Repeat nothing, but print the calls with the names of variables
    #[arg(long, conflicts_with = "fmu")]
    print: bool,
    /// Compile FMUs that have C or C++ sources, but no binary for this machine
    #[arg(long)]
    compile: bool,
    #[command(flatten)]
    limited: Limited,
}

/// Repeats the calls, and prints the first difference.
///
/// # Errors
/// The trace or an FMU cannot be used.
pub fn run(args: ReplayArgs, out: &mut impl Write) -> Result<ExitCode> {
    let component = args.component.as_deref();
    if let Some(program) = &args.c {
        let calls = write_program(&args.trace, component, program)?;
        writeln!(out, "wrote {}: {}", program.display(), ui::count(calls as usize, "call"))?;
        return Ok(ExitCode::SUCCESS);
    }
    if args.print {
        print_calls(&args.trace, component, out)?;
        return Ok(ExitCode::SUCCESS);
    }
    let session = Session::start()?;
    let source = ReplaySource {
        trace: args.trace,
        fmu: args.fmu,
        component: args.component,
        tolerance: Tolerance { absolute: args.absolute, relative: args.relative },
        sandbox: args.limited.sandbox(),
        compilation: Compilation { is_wanted: args.compile, cache: None },
    };
    let (limits, job) = (args.limited.limits(1)?, Job::Replay(source));
    let mut worker = job::start(&mut session::worker()?, session.folder(), limits, &job)?;
    let is_cancelled = || session.signal().is_some();
    let (is_same, lines) = match trace::supervise(&mut worker, &is_cancelled)? {
        ReplayEnd::Done(replayed) => (replayed.first.is_none(), done(&replayed)),
        ReplayEnd::Crashed { place, how, in_trace, first } => {
            let crash = match &in_trace {
                Some(then) => format!("{place}: the process {how}; in the trace, it {then}"),
                None => format!("{place}: the process {how}; in the trace, the call returned"),
            };
            let is_same = in_trace.is_some() && first.is_none();
            (is_same, first.iter().map(described).chain([crash]).collect())
        }
        ReplayEnd::Cancelled => {
            return Ok(session.signal().map_or(ExitCode::FAILURE, session::code));
        }
    };
    for line in lines {
        writeln!(out, "{}", ui::wrapped(&line))?;
    }
    Ok(if is_same { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn described(difference: &Difference) -> String {
    format!("{}: {}", difference.place, difference.text)
}

fn done(replayed: &Replayed) -> Vec<String> {
    let Replayed { calls, first, differing, notes } = replayed;
    let calls = ui::count(*calls as usize, "call");
    let mut lines = Vec::new();
    match first {
        None => lines.push(format!("the same within the tolerance: {calls}")),
        Some(first) => {
            let all = differing.values().sum::<u64>();
            let by_function = differing.iter().map(|(name, count)| format!("{name} {count}"));
            let by_function = Vec::from_iter(by_function).join(", ");
            lines.push(described(first));
            lines.push(format!("different: {all} of {calls}: {by_function}"));
        }
    }
    lines.extend(notes.iter().map(|note| format!("note: {note}")));
    lines
}
