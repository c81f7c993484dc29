//! Supervisor side of a run: receives the reports of the worker until the run ends, crashes or is cancelled.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Error, Result, ensure};
use fmu_description::Value;
use fmu_worker::{Ended, Event, Worker};

use super::completed::Completed;
use super::report::{Ready, Report};
use super::rows::Rows;
use crate::error::warn_of_calls;
use crate::function::{Computed, FunctionCall};
use crate::{Row, RunError, trace};

/// What a supervisor does while it waits for a worker.
pub struct Watch<'a> {
    /// Whether to keep the rows of a run that does not reach its end.
    pub keeps_rows: bool,
    /// The trace that the worker writes, which is completed if an FMU ends its process.
    pub trace: Option<&'a Path>,
    /// Whether items of enumerations are written by their names rather than their numbers.
    pub names_items: bool,
    /// Whether the worker is to do other runs after one that has not ended its process.
    pub keeps_worker: bool,
    /// Whether to stop, asked again and again.
    pub is_cancelled: &'a dyn Fn() -> bool,
    /// Receives warnings: about the system, of each call that does not return for long, and of a process that an FMU has
    /// forked.
    pub warn: &'a dyn Fn(&str),
    /// Receives the time (s) that a run has reached.
    pub progress: &'a dyn Fn(&Ready, f64),
    /// Receives each row, if the worker records them.
    pub row: &'a dyn Fn(&Ready, &Row),
    /// Computes the outputs of a function of the run, by its number, at a time (s).
    pub compute: &'a dyn Fn(usize, f64, &[Value]) -> Computed,
}

/// How a run in a worker has ended. The texts `rows` tell where its rows are, to follow a sentence; they are empty
/// unless there is a file.
#[derive(Debug)]
pub enum RunOutcome {
    /// It has reached its end.
    Finished(Box<SupervisedRun>),
    /// It was cancelled, at this time (s) if it was initialized.
    Cancelled {
        /// The communication point.
        time: Option<f64>,
        /// The place of its rows.
        rows: String,
    },
    /// A call of an FMU has failed or has ended the process, or the run cannot begin.
    Failed {
        /// The reason.
        error: Box<RunError>,
        /// The place of its rows.
        rows: String,
    },
}

/// A run in a worker that has reached its end.
#[derive(Debug)]
pub struct SupervisedRun {
    /// The run.
    pub ready: Ready,
    /// The results besides the rows.
    pub completed: Completed,
    /// The number of rows in the file, if one was written.
    pub rows: Option<u64>,
    /// How the process ended when it unloaded the binaries, unless it exited.
    pub crash: Option<Ended>,
}

/// The time that a worker has to unload the binaries.
const FAREWELL: Duration = Duration::from_secs(10);
/// Interval between writes to the file.
const FLUSH_PERIOD: Duration = Duration::from_secs(1);

/// Waits for a worker that does a run, and writes its rows to a file: Parquet if its name ends in
/// `.parquet`, else CSV. Until the run is complete, they are in a CSV file with the suffix `.part`.
///
/// # Errors
/// The file cannot be written, or the system does not tell the state of the worker.
pub fn supervise(
    worker: &mut Worker,
    file: Option<&Path>,
    watch: &Watch<'_>,
) -> Result<RunOutcome> {
    let kept = file.filter(|_| watch.keeps_rows);
    let mut ready: Option<Ready> = None;
    let mut rows: Option<Rows> = None;
    // The communication point, if the run was initialized.
    let mut cancelled: Option<Option<f64>> = None;
    loop {
        let report = match worker.poll()? {
            Some(Event::Replied) => worker.reply()?,
            Some(Event::Ended(ended)) => {
                let components = ready.map(|ready| ready.components).unwrap_or_default();
                let rows = keep(kept, rows);
                // The run has failed, whether or not the file can be completed.
                let _ = watch.trace.map(|file| trace::close(file, &ended.to_string()));
                return Ok(match cancelled {
                    Some(time) => RunOutcome::Cancelled { time, rows },
                    None => {
                        let error = RunError::crash(worker, &components, &ended.to_string());
                        RunOutcome::Failed { error, rows }
                    }
                });
            }
            None if (watch.is_cancelled)() => {
                cancelled = Some(worker.record().time());
                // Its last rows can still be received.
                worker.kill()?;
                continue;
            }
            None => {
                if let Some(ready) = &ready {
                    warn_of_calls(worker, &ready.components, watch.warn);
                    let time = worker.record().time();
                    time.iter().for_each(|time| (watch.progress)(ready, *time));
                }
                // Whoever reads the rows of a paced run sees them at once.
                let is_paced = ready.as_ref().is_some_and(|ready| ready.is_paced);
                let period = if is_paced { Duration::ZERO } else { FLUSH_PERIOD };
                let is_due = |rows: &&mut Rows| rows.is_due(period);
                if let Some(Err(error)) = rows.as_mut().filter(is_due).map(Rows::flush) {
                    return unwritten(error, kept, rows);
                }
                worker.pause();
                continue;
            }
        };
        let row = match &report {
            Report::Row(row) => Some(&**row),
            Report::Completed(completed) => Some(&completed.last),
            _ => None,
        };
        if let Some(row) = row {
            // An FMU that writes out of bounds may have damaged it.
            let fits = ready.as_ref().is_some_and(|ready| row.fits(&ready.columns));
            ensure!(fits, "the worker process has sent a damaged row");
        }
        match report {
            Report::Row(row) => {
                ready.iter().for_each(|ready| (watch.row)(ready, &row));
                if let Some(Err(error)) = rows.as_mut().map(|rows| rows.push(&row)) {
                    return unwritten(error, kept, rows);
                }
            }
            _ if cancelled.is_some() => {}
            Report::Warning(text) => (watch.warn)(&text),
            Report::Call(FunctionCall { function, time, inputs }) => {
                worker.send(&(watch.compute)(function, time, &inputs));
            }
            Report::Ready(mut new) => {
                if !watch.names_items {
                    new.columns.iter_mut().for_each(|column| column.items.clear());
                }
                let create = |file| Rows::create(file, &new.columns);
                rows = file.map(create).transpose()?;
                ready = Some(new);
                worker.send(&());
            }
            Report::Completed(completed) => {
                let count = match rows.as_mut().map(Rows::complete).transpose() {
                    Ok(count) => count,
                    Err(error) => return unwritten(error, kept, rows),
                };
                rows.map(Rows::place).transpose()?;
                let ready = ready.context("the run has not begun")?;
                warn_of_calls(worker, &ready.components, watch.warn);
                let crash = match watch.keeps_worker {
                    true => None,
                    false => Some(worker.end(FAREWELL)?).filter(
                        |ended| !matches!(ended, Ended::Exited(status) if status.code().is_some()),
                    ),
                };
                let completed = *completed;
                let run = SupervisedRun { ready, completed, rows: count, crash };
                return Ok(RunOutcome::Finished(Box::new(run)));
            }
            Report::Failed(error) => {
                let has_begun = error.call.is_some() || error.time.is_some();
                let rows = if has_begun { keep(kept, rows) } else { String::new() };
                return Ok(RunOutcome::Failed { error, rows });
            }
        }
    }
}

/// The end of a run whose rows cannot be written. A device keeps none, and may be a pipe that nobody reads.
fn unwritten(error: Error, file: Option<&Path>, rows: Option<Rows>) -> Result<RunOutcome> {
    match rows.as_ref().is_some_and(Rows::is_device) {
        true => Err(error),
        false => {
            let error = RunError::new(error, Vec::new());
            Ok(RunOutcome::Failed { error, rows: keep(file, rows) })
        }
    }
}

/// Keeps the rows of a run that did not reach its end. Returns where they are, to follow a sentence.
fn keep(file: Option<&Path>, rows: Option<Rows>) -> String {
    let kept = rows.and_then(Rows::keep);
    match (file, kept) {
        (None, _) => String::new(),
        (_, None) => "; no file was written".into(),
        (_, Some((file, last))) => {
            let file = file.display();
            format!("; the rows up to t = {last:?} s are in {file}")
        }
    }
}
