//! The lock by which the model partitions of scheduled execution protect code from preemption. Its callbacks have no
//! environment, so that it is one for the process.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};

/// The thread that has the lock, and how often it has taken it.
static OWNER: Mutex<Option<(ThreadId, usize)>> = Mutex::new(None);
static RELEASED: Condvar = Condvar::new();

fn owner() -> MutexGuard<'static, Option<(ThreadId, usize)>> {
    OWNER.lock().unwrap_or_else(PoisonError::into_inner)
}

/// `fmi3LockPreemptionCallback`: waits until no other thread has the lock, then takes it once more.
pub(crate) unsafe extern "C" fn lock_preemption() {
    let this = thread::current().id();
    let mut owner = owner();
    while owner.is_some_and(|(other, _)| other != this) {
        owner = RELEASED.wait(owner).unwrap_or_else(PoisonError::into_inner);
    }
    let taken = owner.map_or(0, |(_, taken)| taken);
    *owner = Some((this, taken + 1));
}

/// `fmi3UnlockPreemptionCallback`: releases the lock if the thread has taken it as often. A thread without the lock has
/// nothing to release.
pub(crate) unsafe extern "C" fn unlock_preemption() {
    let this = thread::current().id();
    let mut owner = owner();
    match *owner {
        Some((thread, taken)) if thread == this && taken > 1 => *owner = Some((this, taken - 1)),
        Some((thread, _)) if thread == this => {
            *owner = None;
            RELEASED.notify_one();
        }
        _ => {}
    }
}

/// Releases the lock if this thread has it. Returns whether it had it.
pub(crate) fn release() -> bool {
    let this = thread::current().id();
    let mut owner = owner();
    let had = owner.is_some_and(|(thread, _)| thread == this);
    if had {
        *owner = None;
        RELEASED.notify_one();
    }
    had
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;

    use super::*;

    #[test]
    fn another_thread_waits_until_the_lock_is_released_as_often_as_it_was_taken() {
        static ENTERED: AtomicBool = AtomicBool::new(false);
        // SAFETY: they may be called at any time.
        unsafe {
            unlock_preemption();
            lock_preemption();
            lock_preemption();
            let other = thread::spawn(|| {
                lock_preemption();
                ENTERED.store(true, Ordering::SeqCst);
                unlock_preemption();
            });
            unlock_preemption();
            thread::sleep(Duration::from_millis(20));
            assert!(!ENTERED.load(Ordering::SeqCst));
            unlock_preemption();
            other.join().unwrap();
            assert!(ENTERED.load(Ordering::SeqCst));
            assert!(!release());
            lock_preemption();
            assert!(release());
        }
    }
}
