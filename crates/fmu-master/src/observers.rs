//! The observers of the calls of a run. They run in the worker process.

use std::ffi::c_int;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use anyhow::{Context, Result};
use fmu_host::{CallObserver, LogMessage, ObservedCall};

use crate::profile::{Profile, Profiler};
use crate::trace::Recorder;

/// The observers of a run.
#[derive(Debug, Clone, Default)]
pub(crate) struct Observers {
    pub(crate) components: Arc<[String]>,
    pub(crate) recorder: Option<Arc<Recorder>>,
    pub(crate) profiler: Option<Arc<Profiler>>,
}

impl Observers {
    /// The observer of the calls of a component, if they are observed.
    pub(crate) fn of_component(&self, index: usize) -> Option<Arc<dyn CallObserver>> {
        let is_observed = self.recorder.is_some() || self.profiler.is_some();
        let observer = || ComponentObserver { all: self.clone(), index, call: AtomicU64::new(0) };
        is_observed.then(|| Arc::new(observer()) as Arc<dyn CallObserver>)
    }

    /// Writes the rest of the trace, and returns the profile.
    ///
    /// # Errors
    /// The trace could not be written.
    pub(crate) fn finish(&self) -> Result<Option<Profile>> {
        if let Some(recorder) = &self.recorder {
            recorder.finish().context("the trace could not be written, and is not complete")?;
        }
        Ok(self.profiler.as_ref().map(|profiler| profiler.profile()))
    }
}

/// The observer of the calls of one component.
struct ComponentObserver {
    all: Observers,
    index: usize,
    /// The number of the call in progress.
    call: AtomicU64,
}

impl ComponentObserver {
    fn name(&self) -> &str {
        &self.all.components[self.index]
    }
}

impl CallObserver for ComponentObserver {
    fn begin(&self, call: &ObservedCall<'_>) {
        if let Some(recorder) = &self.all.recorder {
            self.call.store(recorder.begin(self.name(), call), Relaxed);
        }
    }

    fn end(&self, call: &ObservedCall<'_>, status: Option<c_int>, duration: Duration) {
        if let Some(recorder) = &self.all.recorder {
            recorder.end((self.name(), self.call.load(Relaxed)), call, status, duration);
        }
        if let Some(profiler) = &self.all.profiler {
            profiler.add(self.index, call.function, status, duration);
        }
    }

    fn log(&self, message: &LogMessage) {
        if let Some(recorder) = &self.all.recorder {
            recorder.log(self.name(), message);
        }
    }
}
