//! A process that runs simulations, watched by the one that started it.

use std::io;
use std::process::Child;
use std::time::{Duration, Instant};

use fmu_worker::{Ended, Limits, excess, kill, kill_group};

use crate::Recorder;

/// A process that records its calls. It is killed when this value is dropped.
#[derive(Debug)]
pub struct Supervised {
    child: Child,
    recorder: Recorder,
    /// The time limit is that of each call of an FMU.
    limits: Limits,
    call: u64,
    /// When this call was first seen.
    since: Instant,
    reported: bool,
    memory_checked: Instant,
}

/// The time after which a call counts as slow.
const SLOW: Duration = Duration::from_secs(10);
/// Interval between checks of the memory.
const MEMORY_PERIOD: Duration = Duration::from_millis(20);

impl Supervised {
    /// Watches a process that writes to this record.
    pub fn new(child: Child, recorder: Recorder, limits: Limits) -> Self {
        Self {
            child,
            call: recorder.call(),
            recorder,
            limits,
            since: Instant::now(),
            reported: false,
            memory_checked: Instant::now(),
        }
    }

    /// The record of its calls.
    pub fn recorder(&self) -> &Recorder {
        &self.recorder
    }

    /// Whether the process has ended; kills it if it exceeds a limit.
    ///
    /// # Errors
    /// The system does not tell the state of the process.
    pub fn poll(&mut self) -> io::Result<Option<Ended>> {
        if let Some(status) = self.child.try_wait()? {
            return Ok(Some(Ended::Exited(status)));
        }
        let call = self.recorder.call();
        if call != self.call {
            (self.call, self.since, self.reported) = (call, Instant::now(), false);
        }
        let elapsed = self.since.elapsed();
        let hangs = |limit: &Duration| self.recorder.is_in_call() && elapsed >= *limit;
        if let Some(limit) = self.limits.time.filter(hangs) {
            return kill(&mut self.child, Ended::TimedOut(limit)).map(Some);
        }
        if self.memory_checked.elapsed() >= MEMORY_PERIOD {
            self.memory_checked = Instant::now();
            if let Some(used) = excess(&self.child, &self.limits) {
                return kill(&mut self.child, Ended::OutOfMemory(used)).map(Some);
            }
        }
        Ok(None)
    }

    /// Describes the call in progress, once, if it takes long. `names` are those of the components and
    /// of their FMUs.
    pub fn newly_slow(&mut self, names: &[(String, String)]) -> Option<String> {
        if self.reported || self.since.elapsed() < SLOW {
            return None;
        }
        self.reported = true;
        let outcome = format!("has not returned for {} s", SLOW.as_secs());
        Some(self.recorder.failure(names, &outcome)?.event())
    }
}

impl Drop for Supervised {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
        kill_group(self.child.id());
    }
}
