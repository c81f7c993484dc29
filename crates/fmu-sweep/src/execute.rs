//! Parallel execution on all cores.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use rayon::ThreadPoolBuilder;

use crate::{Cell, Error, Plan, Row, Run};

/// The outcome of a sweep without errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// All runs are done.
    Complete,
    /// The sweep was cancelled before all runs were done.
    Cancelled,
}

/// Simulates the runs with these indices, such as [`crate::Journal::pending`] or the share of a worker,
/// on a number of threads (0: one per core).
///
/// Each thread takes the next run as soon as it has finished one. Before its first run it calls `init`
/// to create its own state, which need not be `Send`. `simulate` returns the results of a run, which
/// must depend only on the run and not on the history of the state. `keep` receives parameters and
/// results as a row, in any order; it can append to the journal ([`crate::Journal::append`]), print
/// [`crate::Columns::line`] in one write, and report progress.
///
/// Once `cancel` is set, running simulations are finished and kept, and no new ones are started.
///
/// # Errors
/// If `init`, `simulate` or `keep` returns an error, the plan has no such run, or the threads cannot be
/// started. Like a cancellation, an error ends the sweep after the running simulations. If several
/// threads fail, the error of one of them is returned.
///
/// # Panics
/// If `init`, `simulate` or `keep` panics, after the running simulations of other threads.
pub fn execute<State, R, E>(
    plan: &Plan,
    indices: impl Iterator<Item = u64> + Send,
    threads: usize,
    cancel: &AtomicBool,
    init: impl Fn() -> Result<State, E> + Sync,
    simulate: impl Fn(&mut State, &Run<'_>) -> Result<R, E> + Sync,
    keep: impl Fn(Row) -> Result<(), E> + Sync,
) -> Result<Ended, E>
where
    R: IntoIterator<Item = Cell>,
    E: From<Error> + Send,
{
    let pool = ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|error| Error::new(format!("cannot start threads: {error}")))?;
    let indices = Mutex::new(indices.fuse());
    let next = || indices.lock().expect("counting does not panic").next();
    let stop = AtomicBool::new(false);
    let work = || -> Result<(), E> {
        let _stop = SetWhenDropped(&stop);
        let mut state = None;
        while !stop.load(Relaxed) && !cancel.load(Relaxed) {
            let Some(index) = next() else { break };
            let state = match &mut state {
                Some(state) => state,
                none => none.insert(init()?),
            };
            let run = plan.run(index)?;
            let results = simulate(state, &run)?;
            keep(run.row(results))?;
        }
        Ok(())
    };
    for result in pool.broadcast(|_| work()) {
        result?;
    }
    Ok(match next() {
        None => Ended::Complete,
        Some(_) => Ended::Cancelled,
    })
}

/// Sets a flag when a thread ends, be it by an error, by a panic, or because no run is left.
struct SetWhenDropped<'a>(&'a AtomicBool);

impl Drop for SetWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}

#[cfg(test)]
mod tests;
