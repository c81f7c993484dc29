//! What `simulate` and `sweep` have in common: the limits of their worker processes, and the files
//! that these share with their supervisor.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use fmu_cosim::Recorder;
use fmu_worker::{Ended, Limits, memory};

use crate::style::WARNING;

/// The record of calls.
pub const CALLS: &str = "calls";
/// The rows that are not yet in the file.
pub const ROWS: &str = "rows";
/// The names of the components and of their FMUs.
const NAMES: &str = "names";

/// The limits of worker processes.
#[derive(Debug, Args)]
pub struct Limited {
    /// Time limit of each call of an FMU (0: none)
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    call_timeout: f64,
    /// Maximum memory of all FMUs together [default: 90 % of the memory of the machine]
    #[arg(long, value_name = "GB")]
    memory_limit: Option<f64>,
    /// Run as a worker process that shares this folder with its supervisor
    #[arg(long, value_name = "DIR", hide = true)]
    pub worker: Option<PathBuf>,
}

impl Limited {
    /// The limits of each of several worker processes.
    ///
    /// # Errors
    /// A limit is not a positive number.
    pub fn limits(&self, workers: usize) -> Result<Limits> {
        ensure!(
            self.call_timeout >= 0.0,
            "--call-timeout is {}, expected a number of seconds",
            self.call_timeout
        );
        let memory = match self.memory_limit {
            None => memory::available().map(|bytes| bytes / 10 * 9),
            Some(gigabytes) => {
                ensure!(
                    gigabytes > 0.0,
                    "--memory-limit is {gigabytes}, expected a positive number of GB"
                );
                Some((gigabytes * 1e9) as u64)
            }
        };
        Ok(Limits {
            // More than some centuries is no limit either.
            time: Duration::try_from_secs_f64(self.call_timeout)
                .ok()
                .filter(|limit| !limit.is_zero()),
            memory: memory.map(|bytes| bytes / workers.max(1) as u64),
        })
    }
}

/// Writes the names of the components and of their FMUs for the supervisor.
pub fn write_names(folder: &Path, names: &[(String, String)]) -> Result<()> {
    let text: String = names.iter().map(|(a, b)| format!("{a}\0{b}\0")).collect();
    Ok(fs::write(folder.join(NAMES), text)?)
}

/// The names of the components and of their FMUs; empty if the worker has not come so far.
pub fn names(folder: &Path) -> Vec<(String, String)> {
    let text = fs::read_to_string(folder.join(NAMES)).unwrap_or_default();
    let words: Vec<&str> = text.split_terminator('\0').collect();
    let pairs = words.chunks_exact(2);
    pairs
        .map(|pair| (pair[0].to_owned(), pair[1].to_owned()))
        .collect()
}

/// Says which call has not returned for long.
pub fn report_slow(call: &str) {
    anstream::eprintln!("{WARNING}warning:{WARNING:#} still waiting: {call}");
}

/// Says in which call a worker process has ended.
pub fn explain(recorder: &Recorder, names: &[(String, String)], ended: &Ended) -> String {
    match recorder.failure(names, &ended.to_string()) {
        Some(failure) => failure.to_string(),
        None => format!("the worker process {ended}, outside of the calls of an FMU"),
    }
}
