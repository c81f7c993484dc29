//! The observers of the calls of a run. They run in the worker process.

use std::ffi::c_int;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
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
        let observer = || ComponentObserver { all: self.clone(), index, open: Mutex::default() };
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
    /// The numbers of the calls in progress, each of which is made within the one before.
    open: Mutex<Vec<u64>>,
}

impl ComponentObserver {
    fn name(&self) -> &str {
        &self.all.components[self.index]
    }

    fn open(&self) -> MutexGuard<'_, Vec<u64>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CallObserver for ComponentObserver {
    fn begin(&self, call: &ObservedCall<'_>) {
        if let Some(recorder) = &self.all.recorder {
            self.open().push(recorder.begin(self.name(), call));
        }
    }

    fn end(&self, call: &ObservedCall<'_>, status: Option<c_int>, duration: Duration) {
        if let Some(recorder) = &self.all.recorder {
            let number = self.open().pop().unwrap_or_default();
            recorder.end((self.name(), number), call, status, duration);
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
