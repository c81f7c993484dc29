//! `cargo fmu sweep`: many runs of a system, each with other values.

use std::ops::Range;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Context;
use clap::Args;

/// What to sweep, and where the rows go.
#[derive(Args)]
pub struct Options {
    /// File that describes the sweep; examples/sweep has some
    #[arg(value_name = "SWEEP.toml")]
    pub sweep: PathBuf,
    /// File for the rows, .csv or .parquet [default: the sweep's name with .csv]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Threads; as many as there are cores without it
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    pub threads: usize,
    /// File of the system, in place of that of the sweep
    #[arg(long, value_name = "SYSTEM.toml")]
    pub system: Option<PathBuf>,
    /// Folder to take the FMUs from, in place of those of the system
    #[arg(long, value_name = "DIR")]
    pub fmus: Option<PathBuf>,
    /// Print the rows of these runs, from 0 and without the last, and write no file: what one of
    /// several machines does
    #[arg(long, value_name = "FIRST..END", conflicts_with = "out")]
    pub rows: Option<Runs>,
    /// Print what a coordinator of several machines needs to know, as JSON
    #[arg(long, conflicts_with_all = ["out", "rows"])]
    pub plan: bool,
}

/// `FIRST..END`
#[derive(Debug, Clone)]
#[cfg_attr(
    not(feature = "master"),
    expect(dead_code, reason = "only the master reads it")
)]
pub struct Runs(pub Range<u64>);

impl FromStr for Runs {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> anyhow::Result<Self> {
        let ends = text.split_once("..").and_then(|(first, end)| {
            let range = first.parse().ok()?..end.parse().ok()?;
            (range.start <= range.end).then_some(range)
        });
        ends.map(Self)
            .context("expected FIRST..END, such as 100..200")
    }
}

#[cfg(feature = "master")]
pub use super::sweeping::run;
