//! Supervisor side of sweeps for Python.

use std::cell::{Cell, RefCell};
use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Instant;

use anyhow::anyhow;
use cargo_fmu::progress::Clock;
use cargo_fmu::session::Session;
use fmu_master::FunctionCall;
use fmu_master::job::{self, Job};
use fmu_master::sweep::{RunFunctions, Study, SweepSource, Workers, process_count};
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments;
use crate::error::error;
use crate::run::{Functions, PERIOD, command, limits};

/// Runs a sweep in worker processes, 0 for one per core, which `processes` starts, and writes its table. A sweep or
/// system that has a text is not read from its file. `functions` are the components that are functions, and what makes
/// them for each run. `progress` receives the part that is done, 0 to 1, and the progress in words. Returns warnings
/// and, if all runs failed, why the first one did.
#[pyfunction]
pub fn sweep(
    py: Python<'_>,
    sweep: (PathBuf, Option<String>),
    system: Option<(PathBuf, Option<String>)>,
    functions: (Vec<(String, Bound<'_, PyDict>)>, Py<PyAny>),
    out: PathBuf,
    processes: (usize, Vec<OsString>),
    progress: Option<Py<PyAny>>,
) -> PyResult<(Vec<String>, Option<String>)> {
    let (file, text) = sweep;
    let (system, system_text) = system.map_or((None, None), |(file, text)| (Some(file), text));
    let ((functions, begin), (processes, program)) = (functions, processes);
    let functions = arguments::functions(functions)?;
    let has_functions = !functions.is_empty();
    let source =
        SweepSource { file, text, system, system_text, functions, ..SweepSource::default() };
    py.detach(|| {
        let warnings: RefCell<Vec<String>> = RefCell::default();
        // What ends the sweep, such as Ctrl-C.
        let raised = Rc::new(RefCell::new(None));
        let begin = || {
            let steps = Python::attach(|py| begin.call0(py)?.extract::<Vec<Py<PyAny>>>(py));
            let functions = Functions::new(steps.map_err(|error| {
                *raised.borrow_mut() = Some(error);
                anyhow!("a run cannot begin")
            })?);
            let raised = raised.clone();
            let compute = move |FunctionCall { function, time, inputs }: &FunctionCall| {
                let computed = functions.compute(*function, *time, inputs);
                let is_exception =
                    |e: &PyErr| Python::attach(|py| e.is_instance_of::<PyException>(py));
                if let Some(other) = functions.take_raised().filter(|error| !is_exception(error)) {
                    *raised.borrow_mut() = Some(other);
                }
                computed
            };
            anyhow::Ok(Box::new(compute) as RunFunctions)
        };
        let written = (|| {
            let session = Session::without_signals()?;
            let study = Study::open(&source)?;
            let (count, job) = (process_count(processes), Job::Sweep(source));
            let polled = Cell::new(Instant::now());
            let workers = Workers {
                count,
                start: &|| {
                    let mut command = command(&program);
                    // What an FMU prints is not shown.
                    command.stdout(io::stderr());
                    job::start(&mut command, session.folder(), limits(count), &job)
                },
                is_cancelled: &|| {
                    if polled.get().elapsed() >= PERIOD && raised.borrow().is_none() {
                        polled.set(Instant::now());
                        *raised.borrow_mut() = Python::attach(|py| py.check_signals()).err();
                    }
                    raised.borrow().is_some()
                },
                warn: &|text| warnings.borrow_mut().push(text.to_owned()),
                functions: has_functions.then_some(&begin),
            };
            let (clock, told) = (Clock::default(), Cell::new(None::<Instant>));
            study.write(&out, &workers, |done| {
                let Some(show) = &progress else { return };
                let now = clock.sweep(done);
                let is_due = told.get().is_none_or(|told| told.elapsed() >= PERIOD);
                if is_due && raised.borrow().is_none() {
                    told.set(Some(Instant::now()));
                    *raised.borrow_mut() = Python::attach(|py| show.call1(py, now)).err();
                }
            })
        })();
        if let Some(raised) = raised.take() {
            return Err(raised);
        }
        let (_, progress) = written.map_err(error)?;
        let first = progress.first_failure.filter(|_| progress.failed == progress.runs);
        let runs = progress.runs;
        let failure = first.map(|(run, failure)| {
            let plural = if runs == 1 { "" } else { "s" };
            format!("{runs} of {runs} run{plural} failed, the first was run {run}: {failure}")
        });
        Ok((warnings.into_inner(), failure))
    })
}
