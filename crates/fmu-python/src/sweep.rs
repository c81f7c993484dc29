//! Supervisor side of sweeps for Python.

use std::cell::{Cell, RefCell};
use std::ffi::OsString;
use std::io;
use std::path::PathBuf;
use std::time::Instant;

use cargo_fmu::session::Session;
use fmu_master::job::{self, Job};
use fmu_master::sweep::{Study, SweepSource, Workers, process_count};
use pyo3::prelude::*;

use crate::error::error;
use crate::run::{PERIOD, command, limits};

/// Runs a sweep in worker processes, 0 for one per core, and writes its table. A sweep or system that has a text is not
/// read from its file. Returns warnings and, if all runs failed, why the first one did.
#[pyfunction]
pub fn sweep(
    py: Python<'_>,
    sweep: (PathBuf, Option<String>),
    system: Option<(PathBuf, Option<String>)>,
    out: PathBuf,
    processes: usize,
    program: Vec<OsString>,
) -> PyResult<(Vec<String>, Option<String>)> {
    let (file, text) = sweep;
    let (system, system_text) = system.map_or((None, None), |(file, text)| (Some(file), text));
    let source = SweepSource { file, text, system, system_text, ..SweepSource::default() };
    py.detach(|| {
        let warnings: RefCell<Vec<String>> = RefCell::default();
        let raised = RefCell::new(None);
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
            };
            study.write(&out, &workers, |_| ())
        })();
        if let Some(raised) = raised.into_inner() {
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
