//! What `simulate` and `sweep` have in common: the limits of their worker processes.

use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use fmu_worker::{Limits, available_memory};

use crate::style::WARNING;

/// The limits of worker processes.
#[derive(Debug, Args)]
pub struct Limited {
    /// Time limit of each call of an FMU (0: none)
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    call_timeout: f64,
    /// Maximum memory of all FMUs together [default: 90 % of the memory of the machine]
    #[arg(long, value_name = "GB")]
    memory_limit: Option<f64>,
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
            None => available_memory().map(|bytes| bytes / 10 * 9),
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
            call: Duration::try_from_secs_f64(self.call_timeout)
                .ok()
                .filter(|limit| !limit.is_zero()),
            memory: memory.map(|bytes| bytes / workers.max(1) as u64),
            ..Limits::default()
        })
    }
}

/// Prints a warning.
pub fn warn(text: &str) {
    anstream::eprintln!("{WARNING}warning:{WARNING:#} {text}");
}
