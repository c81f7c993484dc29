//! Runs over all cores.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use rayon::ThreadPoolBuilder;

use crate::{Cell, Error, Plan, Row, Run};

/// How a sweep ended that met no error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// All runs are done.
    Complete,
    /// It was cancelled with runs left to do.
    Cancelled,
}

/// Simulates the runs of these numbers, such as [`crate::Journal::pending`] or the share of a worker, on
/// a number of threads (0: one for each core).
///
/// Each thread takes the next run when it is done with the last, and calls `init` before its first one
/// for a state of its own, which need not be `Send`. `simulate` returns the results of a run, which are
/// to depend on the run and not on what the state did before; `keep` gets the parameters and results as
/// a row, and is the place to count progress: [`crate::Journal::append`], or for a worker, the output of
/// [`crate::Columns::line`] in one piece. Rows come in any order.
///
/// Once `cancel` is set, the runs under way are finished and kept, and no other is begun.
///
/// # Errors
/// If `init`, `simulate` or `keep` gives an error or the plan has no such run; like a cancellation this
/// ends the sweep after the runs under way. If several threads fail, the error of one of them. Or if the
/// threads cannot be started.
///
/// # Panics
/// If `init`, `simulate` or `keep` does, after the runs under way on other threads.
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

/// Set when a thread ends: by an error or a panic, which end the sweep, or because no run is left.
struct SetWhenDropped<'a>(&'a AtomicBool);

impl Drop for SetWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
    }
}

#[cfg(test)]
mod tests;
