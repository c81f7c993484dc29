//! The limits of the worker processes of `simulate` and `sweep`.

use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use fmu_master::Sandbox;
use fmu_worker::{Limits, available_memory};

/// The limits of worker processes.
#[derive(Debug, Args)]
pub struct Limited {
    /// Time limit of each call of an FMU (0: none)
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    call_timeout: f64,
    /// Maximum memory of all FMUs together [default: 90 % of the memory of the machine]
    #[arg(long, value_name = "GB")]
    memory_limit: Option<f64>,
    /// Refuse native binaries; run WebAssembly components only
    #[arg(long)]
    sandbox: bool,
}

/// The time that a process has after the time limit of a call, if it runs components only.
const GRACE: Duration = Duration::from_secs(5);

impl Limited {
    /// How WebAssembly components run.
    pub fn sandbox(&self) -> Sandbox {
        // The process that starts the workers reports an invalid limit.
        let memory = self.limits(1).ok().and_then(|limits| limits.memory);
        Sandbox { is_required: self.sandbox, call: self.call_limit(), memory }
    }

    /// The time limit of each call.
    fn call_limit(&self) -> Option<Duration> {
        // More than some centuries is no limit either.
        let limit = Duration::try_from_secs_f64(self.call_timeout).ok();
        limit.filter(|limit| !limit.is_zero())
    }

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
            // A component ends by itself.
            call: self
                .call_limit()
                .map(|limit| limit + if self.sandbox { GRACE } else { Duration::ZERO }),
            memory: memory.map(|bytes| bytes / workers.max(1) as u64),
            ..Limits::default()
        })
    }
}
