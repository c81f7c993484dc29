//! Supervisor side of `cargo fmu sweep`: many runs of a system, each with different parameter values.

use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use fmu_master::job::{self, Job};
use fmu_master::sweep::{Outline, Study, SweepProgress, SweepSource, Workers, process_count};
use fmu_master::{Compilation, Overrides};
use indicatif::ProgressBar;

use super::files::stem;
use super::limits::Limited;
use crate::plot::Page;
use crate::progress::Clock;
use crate::session::{self, Session};
use crate::ui;

/// The sweep to run, and the destination of its rows.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// Sweep file, such as those in examples/sweep
    #[arg(value_name = "SWEEP.toml")]
    sweep: PathBuf,
    /// Output file, .csv or .parquet [default: the name of the sweep file with .csv]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    #[command(flatten)]
    page: Page,
    /// Number of worker processes [default: one per core]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// System file to use instead of the one named in the sweep file
    #[arg(long, value_name = "SYSTEM.toml")]
    system: Option<PathBuf>,
    /// Folder of the FMUs [default: as in the system file]
    #[arg(long, value_name = "DIR")]
    fmus: Option<PathBuf>,
    /// CSV or Parquet file with values of inputs, instead of the file that the system names
    #[arg(long, value_name = "FILE")]
    input: Option<PathBuf>,
    /// Print the rows of these runs (from 0, END excluded); used by the workers of a distributed
    /// sweep
    #[arg(long, value_name = "FIRST..END", conflicts_with_all = ["out", "file"], value_parser = runs)]
    rows: Option<Range<u64>>,
    /// Print the plan and the runs that are missing as JSON, and read their rows from standard input; used by
    /// the coordinator of a distributed sweep
    #[arg(long, hide = true, conflicts_with_all = ["file", "rows"])]
    collect: bool,
    /// Compile FMUs that have C or C++ sources, but no binary for this machine
    #[arg(long)]
    compile: bool,
    #[command(flatten)]
    limited: Limited,
}

/// Parses `FIRST..END`.
fn runs(text: &str) -> Result<Range<u64>> {
    let ends = text.split_once("..").and_then(|(first, end)| {
        let range = first.parse().ok()?..end.parse().ok()?;
        (range.start <= range.end).then_some(range)
    });
    ends.context("expected FIRST..END, such as 100..200")
}

/// Runs the sweep, or the part selected by the options, in worker processes.
///
/// # Errors
/// A file is invalid or cannot be written, or every run failed.
pub fn run(args: &SweepArgs, out: &mut impl Write) -> Result<ExitCode> {
    args.page.check()?;
    let session = Session::start()?;
    let source = SweepSource {
        file: args.sweep.clone(),
        system: args.system.clone(),
        overrides: Overrides {
            fmus: args.fmus.clone(),
            input: args.input.clone(),
            sandbox: args.limited.sandbox(),
            compilation: Compilation {
                is_wanted: args.compile,
                // The worker processes use what this one compiles.
                cache: Some(session.folder().join("compiled")),
            },
            ..Overrides::default()
        },
        ..SweepSource::default()
    };
    let study = Study::open(&source)?;
    let count = process_count(args.threads);
    let (limits, job) = (args.limited.limits(count)?, Job::Sweep(source));
    let workers = Workers {
        count,
        start: &|| {
            let mut command = session::worker()?;
            // What an FMU prints must not get among the rows.
            command.stdout(io::stderr());
            job::start(&mut command, session.folder(), limits, &job)
        },
        is_cancelled: &|| session.signal().is_some(),
        warn: &ui::warn,
        functions: None,
    };
    let is_complete = if let Some(runs) = &args.rows {
        study.rows(runs.clone(), &workers, |line| {
            Ok(io::stdout().lock().write_all(line.as_bytes())?)
        })?
    } else {
        let by_default =
            || Path::new(args.sweep.file_stem().unwrap_or_default()).with_extension("csv");
        let file = args.out.clone().unwrap_or_else(by_default);
        let written = match args.collect {
            true => collect(&study, &workers, &file, out)?,
            false => write(&study, &workers, &file, out)?,
        };
        if let Some(SweepProgress { runs, failed, first_failure, .. }) = &written {
            writeln!(out, "wrote {}: {}", file.display(), ui::count(*runs, "row"))?;
            args.page.draw_sweep(&stem(&args.sweep), &file, out)?;
            if let (true, Some((run, failure))) = (failed == runs, first_failure) {
                let all = ui::count(*runs, "run");
                bail!("{runs} of {all} failed, the first was run {run}: {failure}");
            }
        }
        written.is_some()
    };
    match session.signal().filter(|_| !is_complete) {
        Some(signal) => Ok(session::code(signal)),
        None => Ok(ExitCode::SUCCESS),
    }
}

/// Collects the rows that a coordinator passes on; returns the progress unless some are missing.
fn collect(
    study: &Study,
    workers: &Workers<'_>,
    file: &Path,
    out: &mut impl Write,
) -> Result<Option<SweepProgress>> {
    let begin = |outline: &Outline<'_>, missing: &[(u64, u64)]| {
        Ok(writeln!(out, "{}", serde_json::to_string(&(outline, missing))?)?)
    };
    study.collect(file, workers, begin, io::stdin().lock())
}

/// Executes the remaining runs and prints a summary; returns the progress unless cancelled.
fn write(
    study: &Study,
    workers: &Workers<'_>,
    file: &Path,
    out: &mut impl Write,
) -> Result<Option<SweepProgress>> {
    let bar = progress_bar()?;
    let (clock, mut begin) = (Clock::default(), Instant::now());
    let (is_complete, progress) = study.write(file, workers, |progress| {
        if progress.done == 0 {
            bar.set_length(progress.runs);
            begin = Instant::now();
        }
        bar.set_message(clock.sweep(progress).1);
        bar.set_position(progress.before + progress.done);
    })?;
    let elapsed = begin.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let (runs, before, done) = (progress.runs, progress.before, progress.done);
    let file = file.display();
    if !is_complete {
        let (all, runs) = (before + done, ui::count(runs, "run"));
        ui::message(format_args!(
            "interrupted; {all} of {runs} are in {file}.part; run the same command to resume"
        ));
        return Ok(None);
    }
    let rate = done as f64 / elapsed;
    let done = ui::count(done, "run");
    writeln!(out, "{done} in {elapsed:.3} s: {rate:.0} a second")?;
    if before > 0 {
        writeln!(out, "{} already done", ui::count(before, "run"))?;
    }
    if let Some((run, failure)) = &progress.first_failure {
        let failed = ui::count(progress.failed, "run");
        let text = format!("{failed} failed, the first was run {run}: {failure}");
        writeln!(out, "{}", ui::wrapped(&text))?;
    }
    if let Some(first) = &progress.first_diverged {
        let (diverged, runs) = (progress.diverged, ui::count(runs, "run"));
        let text = format!("{diverged} of {runs} diverged or failed, the first: {first}");
        writeln!(out, "{}", ui::wrapped(&text))?;
    }
    if let Some((iae, best)) = &progress.best {
        writeln!(out, "{}", ui::wrapped(&format!("smallest iae, {iae:.6e}: {best}")))?;
    }
    Ok(Some(progress))
}

fn progress_bar() -> Result<ProgressBar> {
    let bar = ProgressBar::new(0).with_style(ui::bar()?);
    bar.enable_steady_tick(Duration::from_millis(200));
    Ok(bar)
}
