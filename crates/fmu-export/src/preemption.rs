//! Preemption in scheduled execution (FMI 3.0.2, section 5.1): a host may interrupt a call of an instance by another one,
//! on another thread. Each call uses the instance between the host's `lockPreemption` and `unlockPreemption`, and a
//! host that ignores them gets an error.

use std::sync::atomic::{AtomicBool, Ordering};

use fmi_abi::FmiFunction;
use fmi_abi::fmi3::fmi3PreemptionCallback;
use fmu_description::LogCategory;

use crate::log::Log;

/// Lets one call at a time use an instance.
pub(crate) struct Preemption {
    /// The host's functions, if it has both.
    lock: Option<fmi3PreemptionCallback>,
    unlock: Option<fmi3PreemptionCallback>,
    /// Whether a call uses the instance.
    is_in_use: AtomicBool,
    /// Not the log of the instance, which may be in use.
    log: Log,
}

impl Preemption {
    /// By the callbacks of the host, which are allowed on any thread.
    pub(crate) fn new(
        lock: Option<fmi3PreemptionCallback>,
        unlock: Option<fmi3PreemptionCallback>,
        log: Log,
    ) -> Self {
        // One without the other would leave the host locked.
        let (lock, unlock) = lock.zip(unlock).unzip();
        Self { lock, unlock, is_in_use: AtomicBool::new(false), log }
    }

    /// Begins a call that uses the instance, unless another one does. Returns whether it does not, and
    /// [`end`](Self::end) follows.
    pub(crate) fn begin(&self, call: &FmiFunction) -> bool {
        call_back(self.lock);
        let is_in_use = self.is_in_use.swap(true, Ordering::Acquire);
        if is_in_use {
            let message = format_args!(
                "{}: another call uses the instance; expected no call between lockPreemption and unlockPreemption",
                call.name
            );
            self.log.send(LogCategory::Error, message);
            call_back(self.unlock);
        }
        !is_in_use
    }

    /// Ends the call that uses the instance.
    pub(crate) fn end(&self) {
        self.is_in_use.store(false, Ordering::Release);
        call_back(self.unlock);
    }

    /// Whether a call uses the instance.
    pub(crate) fn is_in_use(&self) -> bool {
        self.is_in_use.load(Ordering::Acquire)
    }
}

/// Calls the host, if it has the function.
fn call_back(function: Option<fmi3PreemptionCallback>) {
    if let Some(function) = function {
        // SAFETY: the host provides this function.
        unsafe { function() };
    }
}
