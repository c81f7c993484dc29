//! The only instance of a model with `#[model(single_instance)]` in a process.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};

/// Whether a process has the only instance that it can have, and the thread that created it.
#[derive(Debug, Default)]
pub struct SingleInstance {
    creator: Mutex<Option<ThreadId>>,
    freed: Condvar,
}

/// Kept by the instance, and given back when it is freed.
pub(crate) struct Place(&'static SingleInstance);

impl SingleInstance {
    /// Without an instance.
    #[must_use]
    pub const fn new() -> Self {
        Self { creator: Mutex::new(None), freed: Condvar::new() }
    }

    fn creator(&self) -> MutexGuard<'_, Option<ThreadId>> {
        self.creator.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The place of a new instance, if there is none.
    pub(crate) fn take(&'static self) -> Option<Place> {
        let mut creator = self.creator();
        let is_free = creator.is_none();
        is_free.then(|| {
            *creator = Some(thread::current().id());
            Place(self)
        })
    }

    /// The place of a new instance of a model in a test, when tests on other threads have dropped theirs.
    pub(crate) fn wait_for(&'static self, model: &str) -> Place {
        let this = thread::current().id();
        let mut creator = self.creator();
        while creator.is_some() {
            if *creator == Some(this) {
                drop(creator);
                panic!("{model} is single_instance; drop its Driver before you make another one");
            }
            creator = self.freed.wait(creator).unwrap_or_else(PoisonError::into_inner);
        }
        *creator = Some(this);
        Place(self)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        *self.0.creator() = None;
        self.0.freed.notify_one();
    }
}
