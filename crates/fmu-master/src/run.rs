//! One run of a system in a worker process, whose rows this process writes to a file.

use std::borrow::{Borrow, Cow};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Error, Result, ensure};
use fmu_description::{Type, Value};
use fmu_file::replace::{Replacement, part};
use fmu_worker::{Ended, Event, Service, Worker};
use serde::{Deserialize, Serialize};

use crate::error::warn_of_calls;
use crate::note::Note;
use crate::simulation::Finished;
use crate::summary::{Summarizer, Summary};
use crate::table::{self, Cell, Column, Format};
use crate::{Experiment, Message, Messages, Plan, Row, RunError, StartValue};

/// What a worker reports about a run.
#[derive(Serialize, Deserialize)]
enum Report<'a> {
    /// It is about to begin.
    Ready(Ready),
    /// A row.
    Row(Cow<'a, Row>),
    /// It needs the outputs of a function: its number, the time (s), and the inputs.
    Call(usize, f64, Cow<'a, [Value]>),
    /// It has reached its end.
    Completed(Completed),
    /// It has failed, or cannot begin.
    Failed(Box<RunError>),
}

/// A run that is about to begin.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Ready {
    /// The names of the components and of their files.
    pub components: Vec<(String, String)>,
    /// The times of the run.
    pub experiment: Experiment,
    /// The end of the last step (s).
    pub end: f64,
    /// The recorded variables.
    pub columns: Vec<Column>,
    /// Choices of the master that the user may want to override.
    pub notes: Vec<Note>,
}

/// A run that has reached its end, or that an FMU has ended.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Completed {
    /// The messages of the FMUs.
    pub messages: Vec<Message>,
    /// The last row.
    pub last: Row,
    /// The summary of all rows.
    pub summary: Summary,
    /// The time that the simulation took, without loading and initializing the FMUs.
    pub duration: Duration,
    /// Which FMU has ended the simulation before the stop time, when and why.
    pub ended: Option<String>,
}

/// Runs a plan in this process. `observe` receives each row, and returns false to end the run.
///
/// # Errors
/// A call of an FMU has failed, or the run cannot begin.
pub fn simulate(
    plan: &Plan,
    starts: &[StartValue],
    messages: &Messages,
    mut observe: impl FnMut(&Row) -> bool,
) -> Result<Completed, Box<RunError>> {
    // Loading the binaries and initializing the FMUs do not count as simulating.
    let mut begin = Instant::now();
    let mut summarizer = Summarizer::new(plan);
    let finished = plan.simulate(starts, messages).and_then(|simulation| {
        begin = Instant::now();
        simulation.run(|row| {
            summarizer.add(row);
            observe(row)
        })
    });
    let duration = begin.elapsed();
    match finished {
        Ok(Finished { messages, last, ended }) => {
            let ended = ended.and_then(|ended| ended.early_end());
            Ok(Completed { messages, last, summary: summarizer.summarize(), duration, ended })
        }
        Err(error) => Err(RunError::new(error, messages.take())),
    }
}

/// Does the run that a supervisor has started this process for; see [`supervise`]. `plan` makes the plan and
/// its start values; the rows are only sent if `records`.
pub fn work<P: Borrow<Plan>>(
    service: &mut Service,
    records: bool,
    plan: impl FnOnce() -> Result<(P, Vec<StartValue>)>,
) -> Result<()> {
    let messages = Messages::recorded(service.record().clone());
    let (plan, starts) = match plan() {
        Ok(planned) => planned,
        Err(error) => {
            service.reply(&Report::Failed(RunError::new(error, Vec::new())));
            return Ok(());
        }
    };
    let plan = plan.borrow();
    service.reply(&Report::Ready(Ready {
        components: plan.names(),
        experiment: plan.experiment,
        end: plan.experiment.last()? + plan.end() - plan.experiment.stop,
        columns: plan.columns.clone(),
        notes: plan.notes.clone(),
    }));
    // The file for the rows can be written.
    let Some(()) = service.task()? else { return Ok(()) };
    let completed = simulate(plan, &starts, &messages, |row| {
        if records {
            send(service, row);
        }
        true
    });
    service.reply(&completed.map_or_else(Report::Failed, Report::Completed));
    // The binaries are unloaded when the plan is dropped, which no longer matters to the run.
    Ok(())
}

/// A function of its own, so that runs that record nothing skip it cheaply.
#[inline(never)]
fn send(service: &mut Service, row: &Row) {
    service.reply(&Report::Row(Cow::Borrowed(row)));
}

/// What computes the outputs of a function, by its number, in the supervisor of this process; see
/// [`Function`](crate::Function).
///
/// # Errors
/// The memory that is shared with the supervisor cannot be opened.
pub fn compute_in_supervisor(
    service: &Service,
) -> Result<impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static> {
    let service = Arc::new(Mutex::new(service.another()?));
    Ok(move |function: usize, time: f64, inputs: &[Value]| {
        let mut service = service.lock().unwrap_or_else(PoisonError::into_inner);
        // Unlike a call of an FMU, an answer of the supervisor has no time limit.
        service.record().end_call();
        service.reply(&Report::Call(function, time, Cow::Borrowed(inputs)));
        match service.task() {
            Ok(Some(computed)) => computed,
            Ok(None) => Err("the run was ended".to_owned()),
            Err(error) => Err(error.to_string()),
        }
    })
}

/// The outputs of a function, or what went wrong.
pub type Computed = Result<Vec<Value>, String>;

/// What a supervisor does while it waits for a worker.
pub struct Watch<'a> {
    /// Whether to keep the rows of a run that does not reach its end.
    pub keeps_rows: bool,
    /// Whether the worker is to do other runs after one that has not ended its process.
    pub keeps_worker: bool,
    /// Whether to stop, asked again and again.
    pub is_cancelled: &'a dyn Fn() -> bool,
    /// Receives warnings: of each call that does not return for long, and of a process that an FMU has forked.
    pub warn: &'a dyn Fn(&str),
    /// Receives the time (s) that a run has reached.
    pub progress: &'a dyn Fn(&Ready, f64),
    /// Receives each row, if the worker records them.
    pub row: &'a dyn Fn(&Ready, &Row),
    /// Computes the outputs of a function of [`compute_in_supervisor`], by its number, at a time (s).
    pub compute: &'a dyn Fn(usize, f64, &[Value]) -> Computed,
}

/// How a run in a worker has ended. The texts `rows` tell where its rows are, to follow a sentence; they are empty
/// unless there is a file.
#[derive(Debug)]
pub enum RunOutcome {
    /// It has reached its end.
    Finished(Box<FinishedRun>),
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
pub struct FinishedRun {
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

/// Waits for a worker that calls [`work`], and writes its rows to a file: Parquet if its name ends in
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
                let is_due = |rows: &&mut Rows| rows.flushed.elapsed() >= FLUSH_PERIOD;
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
            Report::Call(function, time, inputs) => {
                worker.send(&(watch.compute)(function, time, &inputs));
            }
            Report::Ready(new) => {
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
                let run = FinishedRun { ready, completed, rows: count, crash };
                return Ok(RunOutcome::Finished(Box::new(run)));
            }
            Report::Failed(error) => {
                let rows = if error.call.is_some() { keep(kept, rows) } else { String::new() };
                return Ok(RunOutcome::Failed { error, rows });
            }
        }
    }
}

/// The end of a run whose rows cannot be written. A device keeps none, and may be a pipe that nobody reads.
fn unwritten(error: Error, file: Option<&Path>, rows: Option<Rows>) -> Result<RunOutcome> {
    match rows.as_ref().is_some_and(|rows| part(&rows.path).is_none()) {
        true => Err(error),
        false => {
            let error = RunError::new(error, Vec::new());
            Ok(RunOutcome::Failed { error, rows: keep(file, rows) })
        }
    }
}

/// Keeps the rows of a run that did not reach its end, if there are any, in the file with the suffix `.part`
/// unless it is a device. Returns where they are, to follow a sentence.
fn keep(file: Option<&Path>, rows: Option<Rows>) -> String {
    let kept = rows.and_then(|mut rows| {
        // As many as the disk has room for.
        let _ = rows.flush();
        let last = rows.last?;
        let place = part(&rows.path).unwrap_or(rows.path);
        let _ = rows.part.keep();
        Some((place, last))
    });
    match (file, kept) {
        (None, _) => String::new(),
        (_, None) => "; no file was written".into(),
        (_, Some((file, last))) => {
            let file = file.display();
            format!("; the rows up to t = {last:?} s are in {file}")
        }
    }
}

/// The rows of a run and the file that they are written to.
struct Rows {
    path: PathBuf,
    part: Replacement,
    /// The time and the recorded variables.
    columns: Vec<Column>,
    /// The text that is not yet in the file, and where each of its rows ends, with its time (s).
    text: String,
    ends: Vec<(usize, f64)>,
    /// The number of rows in the file, and the time of the last one (s).
    count: u64,
    last: Option<f64>,
    flushed: Instant,
}

/// The length of the text that is collected before it is written (bytes).
const BUFFER: usize = 1 << 16;

impl Rows {
    /// Starts a file.
    fn create(path: &Path, recorded: &[Column]) -> Result<Self> {
        ensure!(!path.is_dir(), "{} is a folder", path.display());
        let mut columns = vec![Column::new("time", "s", Type::Float64)];
        columns.extend_from_slice(recorded);
        let mut rows = Self {
            path: path.to_owned(),
            part: Replacement::part(path)?,
            text: table::header(&columns),
            ends: Vec::new(),
            columns,
            count: 0,
            last: None,
            flushed: Instant::now(),
        };
        rows.flush()?;
        Ok(rows)
    }

    fn push(&mut self, row: &Row) -> Result<()> {
        let values = [Value::Float64(row.time)].into_iter();
        let values = values.chain(row.values(&self.columns[1..]));
        table::push_line(&mut self.text, values.map(Some));
        self.ends.push((self.text.len(), row.time));
        if self.text.len() >= BUFFER { self.flush() } else { Ok(()) }
    }

    /// Writes what was collected. If the disk is full, the file ends with a whole row.
    fn flush(&mut self) -> Result<()> {
        let (text, ends) = (std::mem::take(&mut self.text), std::mem::take(&mut self.ends));
        let before = self.part.length().unwrap_or(0);
        let result = self.part.write_all(text.as_bytes());
        let mut whole = ends.len();
        if result.is_err() {
            let written = self.part.length().unwrap_or(before) - before;
            whole = ends.partition_point(|(end, _)| *end as u64 <= written);
            let end = ends[..whole].last().map_or(0, |(end, _)| *end as u64);
            // A row that is not whole does no harm to those before it.
            let _ = self.part.truncate(before + end);
        }
        self.count += whole as u64;
        self.last = ends[..whole].last().map(|(_, time)| *time).or(self.last);
        self.flushed = Instant::now();
        result.with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// The file that is written if the table is not CSV, from the file of the rows.
    fn source(&self) -> Option<PathBuf> {
        part(&self.path).filter(|_| Format::of(&self.path) == Some(Format::Parquet))
    }

    /// Writes what is left, and returns the number of rows.
    fn complete(&mut self) -> Result<u64> {
        self.flush()?;
        let columns = &self.columns;
        if let Some(source) = self.source() {
            let text = fs::read_to_string(&source);
            let text = text.with_context(|| format!("cannot read {}", source.display()))?;
            let (_, mut rest) = text.split_at(table::header(columns).len());
            let rows = std::iter::from_fn(|| {
                let row: Result<(Vec<Cell>, &str)> = match rest {
                    "" => return None,
                    _ => table::parse(columns, rest),
                };
                rest = row.as_ref().map_or("", |(_, rest)| rest);
                Some(row.map(|(cells, _)| cells))
            });
            table::write_parquet(&self.path, columns, rows)?;
        }
        Ok(self.count)
    }

    /// Moves the file into place, unless the table is already there in another format.
    fn place(self) -> Result<()> {
        if self.source().is_some() {
            return Ok(());
        }
        let cannot = || format!("cannot write {}", self.path.display());
        match self.part.keep()? {
            Some(part) => fs::rename(&part, part.with_extension("")).with_context(cannot),
            None => Ok(()),
        }
    }
}
