//! Supervisor side of runs for Python, in a worker process or in the process of Python.

use std::cell::{Cell, RefCell};
use std::ffi::OsString;
use std::process::Command;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use cargo_fmu::progress::Clock;
use cargo_fmu::session::{Session, WORKER};
use fmu_description::Value;
use fmu_master::Computed;
use fmu_master::curve::{self, Curve};
use fmu_master::job::{self, Job, LoadedSystem, SystemSource};
use fmu_master::run::{self, Completed, Ready, RunOutcome, Watch, supervise};
use fmu_master::{
    Column, Experiment, Message, Messages, Note, Plan, Row, RunError, Statistics, Summary,
};
use fmu_worker::{Limits, ProcessOwned, Worker, available_memory};
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyDict, PyString, PyTuple};

use crate::arguments;
use crate::error::{FmuError, error, error_arguments};
use crate::values::{Columns, from_python, to_python};
use crate::words;

/// Interval between looks at Ctrl-C, and between reports of the progress.
pub const PERIOD: Duration = Duration::from_millis(50);
/// Most rows between looks at the clock in this process, which take longer than a fast row.
const ROWS: usize = 256;
/// Time limit of each call of an FMU.
const CALL: Duration = Duration::from_secs(300);

/// The outcome of a run, with its rows.
#[derive(Default)]
struct Outcome {
    columns: Vec<Column>,
    curves: Vec<Curve>,
    rows: Columns,
    notes: Vec<Note>,
    warnings: Vec<String>,
    /// `None` if it was cancelled.
    end: Option<Result<Completed, Box<RunError>>>,
}

/// Runs systems, in worker processes or in this one.
#[pyclass(module = "fmu_master._native", frozen)]
pub struct Runner {
    program: Vec<OsString>,
    keeps: bool,
    idle: ProcessOwned<Mutex<Vec<Kept>>>,
}

/// What is kept of a run for the next one.
#[derive(Default)]
struct Kept {
    /// The session is dropped after the worker.
    worker: Option<(Worker, Session)>,
    loaded: LoadedSystem,
    functions: Arc<Functions>,
}

#[pymethods]
impl Runner {
    /// `program` starts a worker process; if it is empty, runs are in this process. If the runner `keeps` FMUs,
    /// they stay loaded while the same system is run, once for each run at the same time.
    #[new]
    fn new(program: Vec<OsString>, keeps: bool) -> Self {
        Self { program, keeps, idle: ProcessOwned::new(Mutex::default()) }
    }

    /// Runs a system, whose functions call `steps`; returns a dict with the columns and what else there is to tell.
    /// `progress` receives the part that is done, 0 to 1, and the progress in words.
    fn run<'py>(
        &self,
        py: Python<'py>,
        system: &Bound<'py, PyDict>,
        steps: Vec<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        if !self.program.is_empty() && !self.idle.is_of_this_process() {
            return Err(FmuError::new_err(
                "the system was loaded by the process from which this one was forked, expected one that this one has loaded",
            ));
        }
        let system = arguments::system(system)?;
        let (outcome, raised) = py.detach(|| {
            let idle = || self.idle.lock().unwrap_or_else(PoisonError::into_inner);
            let looked = Cell::new(Instant::now());
            let (clock, raised) = (Clock::default(), RefCell::default());
            let host = Host { progress, clock, looked, raised };
            let mut kept = idle().pop().unwrap_or_default();
            *kept.functions.called() = Called { steps, raised: None };
            let outcome = match self.program.is_empty() {
                false => in_worker(system, &self.program, self.keeps, &mut kept, &host),
                true => in_this_process(system, &mut kept, &host),
            };
            let raised = std::mem::take(&mut *kept.functions.called()).raised;
            if self.keeps {
                idle().push(kept);
            }
            match host.raised.take() {
                Some(raised) => Err(raised),
                None => Ok((outcome.map_err(error)?, raised)),
            }
        })?;
        match raised {
            // Such as Ctrl-C.
            Some(raised) if !raised.is_instance_of::<PyException>(py) => Err(raised),
            raised => into_python(py, outcome, raised),
        }
    }

    /// Ends the worker processes and frees the FMUs.
    fn free(&self, py: Python<'_>) {
        if !self.idle.is_of_this_process() {
            return;
        }
        py.detach(|| self.idle.lock().unwrap_or_else(PoisonError::into_inner).clear());
    }
}

/// The outcome of a run as a dict, with the exception of a function.
fn into_python(
    py: Python<'_>,
    outcome: Outcome,
    raised: Option<PyErr>,
) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("columns", outcome.rows.into_python(py, &outcome.columns)?)?;
    let enumerations = PyDict::new(py);
    for Column { name, items, .. } in outcome.columns.iter().filter(|c| !c.items.is_empty()) {
        enumerations.set_item(name, items.clone())?;
    }
    dict.set_item("enumerations", enumerations)?;
    let held = outcome.curves.iter().zip(&outcome.columns).filter(|(curve, _)| curve.is_held);
    dict.set_item("held", Vec::from_iter(held.map(|(_, column)| &column.name)))?;
    dict.set_item("set_points", words::set_points(&outcome.columns, &outcome.curves))?;
    dict.set_item("notes", Vec::from_iter(outcome.notes.iter().map(words::note)))?;
    dict.set_item("warnings", outcome.warnings)?;
    let messages = match outcome.end {
        None => Vec::new(),
        Some(Ok(completed)) => {
            let Completed {
                messages,
                last,
                summary,
                duration,
                profile,
                ended,
                punctuality,
                adaptive_steps,
                unsaved,
            } = completed;
            dict.set_item("profile", profile.as_ref().map(words::profile))?;
            if let Some(unsaved) = unsaved {
                dict.set_item(
                    "error",
                    error_arguments(*RunError::new(anyhow!(unsaved), Vec::new())),
                )?;
            }
            dict.set_item("alarms", Vec::from_iter(summary.sentences()))?;
            dict.set_item("summary", statistics(py, &outcome.columns, &last, &summary)?)?;
            dict.set_item("ended", ended)?;
            let kept = punctuality.map(|punctuality| words::punctuality(py, &punctuality));
            dict.set_item("real_time", kept.transpose()?)?;
            let steps = adaptive_steps
                .map(|steps| (steps.accepted, steps.rejected, steps.smallest, steps.missed));
            dict.set_item("adaptive_steps", steps)?;
            dict.set_item("duration", duration.as_secs_f64())?;
            messages
        }
        Some(Err(mut error)) => {
            let messages = std::mem::take(&mut error.messages);
            dict.set_item("error", error_arguments(*error))?;
            messages
        }
    };
    let message = |m: Message| (m.instance, m.level.name(), m.text, m.times, m.category);
    dict.set_item("messages", Vec::from_iter(messages.into_iter().map(message)))?;
    dict.set_item("raised", raised)?;
    Ok(dict)
}

/// The statistics of each column of numbers, and its last value, by name.
fn statistics<'py>(
    py: Python<'py>,
    columns: &[Column],
    last: &Row,
    summary: &Summary,
) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    for ((column, last), statistics) in
        columns.iter().zip(last.values(columns)).zip(&summary.statistics)
    {
        let Some(Statistics { min, max, rms }) = statistics else { continue };
        let one = PyDict::new(py);
        for (key, value) in [("min", min), ("max", max), ("rms", rms)] {
            one.set_item(key, value)?;
        }
        let number =
            |last: Value| last.as_real().or_else(|| last.as_whole().map(|whole| whole as f64));
        // Absent is no number.
        one.set_item("last", last.map_or(Some(f64::NAN), number))?;
        all.set_item(&column.name, one)?;
    }
    Ok(all)
}

/// The start time, stop time and step (s) of a system.
#[pyfunction]
pub fn times(py: Python<'_>, system: &Bound<'_, PyDict>) -> PyResult<(f64, f64, f64)> {
    let Experiment { start, stop, step } = plan(py, system)?.times();
    Ok((start, stop, step))
}

/// The communication points of a system (s) and the one after the last, as bytes.
#[pyfunction]
pub fn points<'py>(
    py: Python<'py>,
    system: &Bound<'_, PyDict>,
) -> PyResult<Bound<'py, PyByteArray>> {
    let plan = plan(py, system)?;
    let steps = plan.experiment.steps().map_err(error)?;
    let points = (plan.first()..=steps).map(|k| plan.experiment.time(k));
    let bytes = Vec::from_iter(points.flat_map(f64::to_ne_bytes));
    Ok(PyByteArray::new(py, &bytes))
}

/// The smallest and the largest value of each recorded variable of a system, None where there is none.
#[pyfunction]
pub fn bounds(py: Python<'_>, system: &Bound<'_, PyDict>) -> PyResult<Vec<[Option<f64>; 2]>> {
    Ok(plan(py, system)?.bounds)
}

fn plan(py: Python<'_>, system: &Bound<'_, PyDict>) -> PyResult<Plan> {
    let system = arguments::system(system)?;
    let never = |_: usize, _: f64, _: &[Value]| Err(String::new());
    let (plan, _) = py.detach(|| system.plan(&never, &mut |_| ())).map_err(error)?;
    Ok(plan)
}

/// The functions of Python in the current run.
#[derive(Default)]
pub struct Functions(Mutex<Called>);

#[derive(Default)]
struct Called {
    steps: Vec<Py<PyAny>>,
    /// What one has raised.
    raised: Option<PyErr>,
}

impl Functions {
    /// Functions of a run, by their numbers.
    pub fn new(steps: Vec<Py<PyAny>>) -> Self {
        Self(Mutex::new(Called { steps, raised: None }))
    }

    /// Takes what one has raised.
    pub fn take_raised(&self) -> Option<PyErr> {
        self.called().raised.take()
    }

    fn called(&self) -> MutexGuard<'_, Called> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Calls one, with Python's lock.
    pub fn compute(&self, function: usize, time: f64, inputs: &[Value]) -> Computed {
        Python::attach(|py| {
            self.call(py, function, time, inputs).map_err(|raised| {
                let text = raised.to_string();
                self.called().raised = Some(raised);
                text
            })
        })
    }

    fn call(
        &self,
        py: Python<'_>,
        function: usize,
        time: f64,
        inputs: &[Value],
    ) -> PyResult<Vec<Value>> {
        let inputs = inputs.iter().map(|value| to_python(py, value.clone()));
        let time = time.into_pyobject(py)?.into_any();
        let arguments = [Ok(time)].into_iter().chain(inputs).collect::<PyResult<Vec<_>>>()?;
        let step = self.called().steps[function].clone_ref(py);
        let result = step.bind(py).call1(PyTuple::new(py, arguments)?)?;
        let results = match result.try_iter() {
            Ok(several) if !result.is_instance_of::<PyString>() => {
                several.collect::<PyResult<_>>()?
            }
            _ => vec![result],
        };
        results.iter().map(from_python).collect()
    }
}

/// Python, during a run without its lock.
struct Host {
    progress: Option<Py<PyAny>>,
    clock: Clock,
    looked: Cell<Instant>,
    /// What was raised, which ends the run.
    raised: RefCell<Option<PyErr>>,
}

impl Host {
    /// Lets Python handle signals, and tells it the progress of a run that has reached a time (s); returns whether
    /// to end the run.
    fn look(&self, reached: Option<(Experiment, f64)>) -> bool {
        if self.looked.get().elapsed() >= PERIOD && self.raised.borrow().is_none() {
            self.looked.set(Instant::now());
            let looked = Python::attach(|py| {
                if let (Some(progress), Some((experiment, time))) = (&self.progress, reached) {
                    progress.call1(py, self.clock.run(experiment, time))?;
                }
                py.check_signals()
            });
            *self.raised.borrow_mut() = looked.err();
        }
        self.raised.borrow().is_some()
    }
}

/// Starts a worker process for a job. `program` starts the command line; the folder of the session must outlive the
/// process.
///
/// # Errors
/// The process cannot be started.
pub fn start(session: &Session, program: &[OsString], job: &Job) -> Result<Worker> {
    let worker = job::start(&mut command(program), session.folder(), limits(1), job);
    worker.context("cannot start a worker process")
}

/// A command that starts a worker process, for words that start the command line.
pub fn command(program: &[OsString]) -> Command {
    let mut command = Command::new(&program[0]);
    command.args(&program[1..]).args(WORKER);
    command
}

/// The limits of each of several worker processes.
pub fn limits(count: usize) -> Limits {
    let memory = available_memory().map(|bytes| bytes / 10 * 9 / count as u64);
    Limits { call: Some(CALL), memory, ..Limits::default() }
}

/// Runs a system in a worker process, the one of the run before if it was kept.
fn in_worker(
    system: SystemSource,
    program: &[OsString],
    keeps: bool,
    kept: &mut Kept,
    host: &Host,
) -> Result<Outcome> {
    let trace = system.overrides.observation.trace.clone();
    let job = Job::Run { system, records: true };
    let mut process = match kept.worker.take() {
        Some((mut worker, session)) => {
            worker.send(&job);
            (worker, session)
        }
        None => {
            let session = Session::without_signals()?;
            (start(&session, program, &job)?, session)
        }
    };
    let rows = RefCell::new(Outcome::default());
    let times = Cell::new(None);
    let outcome = supervise(
        &mut process.0,
        None,
        &Watch {
            keeps_rows: false,
            trace: trace.as_deref(),
            names_items: true,
            keeps_worker: keeps,
            is_cancelled: &|| host.look(times.get()),
            warn: &|text| rows.borrow_mut().warnings.push(text.to_owned()),
            progress: &|ready, time| {
                times.set(Some((ready.experiment, time)));
            },
            row: &|ready, row| {
                let mut rows = rows.borrow_mut();
                rows.rows.push(&ready.columns, row);
                if rows.columns.len() != ready.columns.len() {
                    rows.columns.clone_from(&ready.columns);
                    rows.curves.clone_from(&ready.curves);
                }
            },
            compute: &|function, time, inputs| kept.functions.compute(function, time, inputs),
        },
    )?;
    // A run that failed may have left an FMU that must not be called again, unless a function of Python has ended it.
    let is_failed = matches!(outcome, RunOutcome::Failed { .. });
    let is_sound = keeps && (!is_failed || kept.functions.called().raised.is_some());
    if is_sound && matches!(process.0.poll(), Ok(None)) {
        kept.worker = Some(process);
    }
    let mut rows = rows.into_inner();
    rows.end = match outcome {
        RunOutcome::Cancelled { .. } => None,
        RunOutcome::Failed { error, .. } => Some(Err(error)),
        RunOutcome::Finished(run) => {
            let crash = run.crash.map(|ended| format!("after the simulation, the process {ended}"));
            rows.warnings.extend(crash);
            let Ready { columns, curves, notes, .. } = run.ready;
            (rows.columns, rows.curves, rows.notes) = (columns, curves, notes);
            Some(Ok(run.completed))
        }
    };
    Ok(rows)
}

/// Runs a system in this process.
fn in_this_process(system: SystemSource, kept: &mut Kept, host: &Host) -> Result<Outcome> {
    let functions = kept.functions.clone();
    let compute = move |function, time, inputs: &[Value]| functions.compute(function, time, inputs);
    let observation = system.overrides.observation.clone();
    let mut outcome = Outcome::default();
    let mut warn = |text: &str| outcome.warnings.push(text.to_owned());
    let planned = kept.loaded.plan(system, &compute, &mut warn);
    let planned = planned.and_then(|(plan, starts)| {
        Ok((plan, starts, observation.begin(Messages::default(), &plan.components)?))
    });
    let (plan, starts, messages) = match planned {
        Ok(planned) => planned,
        Err(error) => {
            outcome.end = Some(Err(RunError::new(error, Vec::new())));
            return Ok(outcome);
        }
    };
    let (mut looked, mut rows, mut left) = (Instant::now(), 1, 1);
    let end = run::simulate(plan, &starts, &messages, |row| {
        outcome.rows.push(&plan.columns, row);
        left -= 1;
        if left > 0 {
            return true;
        }
        let now = Instant::now();
        rows = if now - looked < PERIOD / 2 { ROWS.min(2 * rows) } else { 1 };
        (looked, left) = (now, rows);
        !host.look(Some((plan.times(), row.time)))
    });
    outcome.columns.clone_from(&plan.columns);
    outcome.curves = curve::of_plan(plan);
    outcome.notes = plan.notes(&starts);
    outcome.end = Some(end);
    Ok(outcome)
}
