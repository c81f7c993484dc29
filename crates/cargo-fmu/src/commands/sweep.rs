//! `cargo fmu sweep`: many runs of a system, each with different parameter values.

use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use fmu_sweep::{Progress, Study};
use indicatif::{ProgressBar, ProgressStyle};

/// The sweep to run, and the destination of its rows.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// Sweep file, such as those in examples/sweep
    #[arg(value_name = "SWEEP.toml")]
    sweep: PathBuf,
    /// Output file, .csv or .parquet [default: the name of the sweep file with .csv]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Number of threads [default: one per core]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// System file to use instead of the one named in the sweep file
    #[arg(long, value_name = "SYSTEM.toml")]
    system: Option<PathBuf>,
    /// Folder of the FMUs
    #[arg(long, value_name = "DIR")]
    fmus: Option<PathBuf>,
    /// Print the rows of these runs (from 0, END excluded); used by the workers of a distributed
    /// sweep
    #[arg(long, value_name = "FIRST..END", conflicts_with = "out")]
    rows: Option<Runs>,
    /// Print the plan as JSON; used by the coordinator of a distributed sweep
    #[arg(long, conflicts_with_all = ["out", "rows"])]
    plan: bool,
}

/// `FIRST..END`
#[derive(Debug, Clone)]
struct Runs(Range<u64>);

impl FromStr for Runs {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let ends = text.split_once("..").and_then(|(first, end)| {
            let range = first.parse().ok()?..end.parse().ok()?;
            (range.start <= range.end).then_some(range)
        });
        ends.map(Self)
            .context("expected FIRST..END, such as 100..200")
    }
}

/// Runs the sweep, or the part selected by the options.
///
/// # Errors
/// A file is invalid or cannot be written, or an FMU rejects a start value.
pub fn run(args: &SweepArgs, out: &mut impl Write) -> Result<()> {
    let file = || args.sweep.display().to_string();
    let study = Study::open(&args.sweep, args.system.as_deref(), args.fmus.as_deref())
        .with_context(file)?;
    if let Some(Runs(runs)) = &args.rows {
        return study.rows(runs.clone(), args.threads, |line| {
            Ok(io::stdout().lock().write_all(line.as_bytes())?)
        });
    }
    study.try_corners().with_context(file)?;
    if args.plan {
        let outline = serde_json::to_string(&study.outline()?)?;
        return Ok(writeln!(out, "{outline}")?);
    }
    write(&study, args, out)
}

/// Executes the remaining runs and prints a summary.
fn write(study: &Study, args: &SweepArgs, out: &mut impl Write) -> Result<()> {
    let file = match &args.out {
        Some(file) => file.clone(),
        None => {
            let name = args.sweep.file_stem().unwrap_or_default();
            Path::new(name).with_extension("csv")
        }
    };
    let bar = progress_bar()?;
    let (mut begin, mut progress) = (Instant::now(), Progress { runs: 0, before: 0 });
    study.write(&file, args.threads, |start| {
        bar.set_length(start.runs);
        bar.set_position(start.before);
        bar.reset_eta();
        (begin, progress) = (Instant::now(), start);
        || bar.inc(1)
    })?;
    let elapsed = begin.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let Progress { runs, before } = progress;
    let left = runs - before;
    writeln!(
        out,
        "{left} runs in {elapsed:.3} s: {:.0} a second",
        left as f64 / elapsed
    )?;
    if before > 0 {
        writeln!(out, "{before} runs were already done")?;
    }
    if let Some((run, failure)) = study.first_failure() {
        writeln!(
            out,
            "some runs stopped early, the first was run {run}: {failure}"
        )?;
    }
    writeln!(out, "wrote {}: {runs} rows", file.display())?;
    Ok(())
}

fn progress_bar() -> Result<ProgressBar> {
    let style = "[{bar:40}] {pos} of {len} runs, {per_sec}, {eta} left";
    let style = ProgressStyle::with_template(style)?.progress_chars("=> ");
    let bar = ProgressBar::new(0).with_style(style);
    bar.enable_steady_tick(Duration::from_millis(200));
    Ok(bar)
}
