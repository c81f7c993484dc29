//! One FMU that Python steps by hand, in a worker process or in this one.

use std::ffi::OsString;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use cargo_fmu::session::Session;
use fmu_description::{Value, Variable};
use fmu_master::RunError;
use fmu_master::job::Job;
use fmu_master::stepped_fmu::{Names, Request, Response, SteppedFmu};
use fmu_worker::{Event, ProcessOwned, Record, Worker};
use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedStr;
use pyo3::sync::MutexExt;
use pyo3::types::PyDict;

use crate::arguments;
use crate::error::{FmuError, error, to_exception};
use crate::run::{PERIOD, start};
use crate::values::{literal, to_python};

/// Where the FMU is.
enum Place {
    Here(Box<SteppedFmu>),
    /// The session is dropped after the worker.
    There(Box<Worker>, Session),
}

/// An instance of an FMU. Variables are scalars or elements, by their numbers.
#[pyclass(module = "fmu_master._native")]
pub struct Instance {
    names: Names,
    /// A forked process must not wait for a thread that it does not have.
    place: ProcessOwned<Mutex<Option<Place>>>,
    is_here: bool,
    /// States that are no longer needed. The next call of `save` frees them.
    forgotten: Mutex<Vec<u64>>,
}

impl Instance {
    /// Waits without Python's lock, which the thread that has the FMU needs to return.
    fn place(&self, py: Python<'_>) -> MutexGuard<'_, Option<Place>> {
        self.place.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }

    fn forgotten(&self) -> MutexGuard<'_, Vec<u64>> {
        self.forgotten.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn request<'py>(&self, py: Python<'py>, request: Request) -> PyResult<Bound<'py, PyAny>> {
        into_python(py, self.respond(py, &request)?)
    }

    fn respond(&self, py: Python<'_>, request: &Request) -> PyResult<Response> {
        if !self.is_here && !self.place.is_of_this_process() {
            let (name, _) = self.names.names();
            return Err(FmuError::new_err(format!(
                "{name} runs for the process from which this one was forked, expected an Instance that this one has made"
            )));
        }
        let mut place = self.place(py);
        match place.as_mut().context("the instance was freed").map_err(error)? {
            // Not worth releasing the lock of Python, unless the FMU computes for long.
            Place::Here(fmu) if !matches!(request, Request::Step(_) | Request::Initialize(_)) => {
                fmu.fulfil(request).map_err(error)
            }
            Place::Here(fmu) => py.detach(|| fmu.fulfil(request)).map_err(error),
            Place::There(worker, _) => {
                worker.send(request);
                let response = receive(py, worker, &self.names);
                if response.is_err() && matches!(worker.poll(), Ok(Some(Event::Ended(_))) | Err(_))
                {
                    *place = None;
                }
                response
            }
        }
    }

    fn typed(&self, values: Values<'_>) -> PyResult<Vec<(usize, Value)>> {
        let mut typed = Vec::with_capacity(values.len());
        for (name, value) in values {
            typed.extend(self.names.typed(&name, literal(&value)?).map_err(error)?);
        }
        Ok(typed)
    }
}

/// A response as Python gets it.
fn into_python(py: Python<'_>, response: Response) -> PyResult<Bound<'_, PyAny>> {
    match response {
        Response::Time(time) => time.into_bound_py_any(py),
        Response::Numbers(numbers) => numbers.into_bound_py_any(py),
        Response::Saved(number) => number.into_bound_py_any(py),
        Response::Values(values) => {
            let values = values.into_iter().map(|value| to_python(py, value));
            values.collect::<PyResult<Vec<_>>>()?.into_bound_py_any(py)
        }
    }
}

/// Waits for the response of a worker; Ctrl-C ends the worker.
fn receive(py: Python<'_>, worker: &mut Worker, names: &Names) -> PyResult<Response> {
    py.detach(|| {
        let mut looked = Instant::now();
        loop {
            match worker.poll()? {
                Some(Event::Replied) => {
                    return worker
                        .reply::<Result<Response, Box<RunError>>>()?
                        .map_err(|error| to_exception(*error));
                }
                Some(Event::Ended(ended)) => {
                    let names = [names.names()];
                    return Err(to_exception(*RunError::crash(worker, &names, &ended.to_string())));
                }
                None if looked.elapsed() >= PERIOD => {
                    looked = Instant::now();
                    if let Err(raised) = Python::attach(|py| py.check_signals()) {
                        worker.kill()?;
                        return Err(raised);
                    }
                }
                None => worker.pause(),
            }
        }
    })
}

/// Values of variables, by their names.
type Values<'py> = Vec<(PyBackedStr, Bound<'py, PyAny>)>;

/// A variable as Python gets it: name, causality, variability, type, unit, start values, description, dimensions,
/// smallest and largest value.
type Described<'py> = (
    String,
    &'static str,
    &'static str,
    &'static str,
    String,
    Vec<Bound<'py, PyAny>>,
    String,
    Vec<usize>,
    Option<Bound<'py, PyAny>>,
    Option<Bound<'py, PyAny>>,
);

#[pymethods]
impl Instance {
    /// Instantiates an FMU, in this process unless `program` starts a worker process.
    #[new]
    fn new(py: Python<'_>, setup: &Bound<'_, PyDict>, program: Vec<OsString>) -> PyResult<Self> {
        let setup = arguments::setup(setup)?;
        let (names, place) = py
            .detach(|| {
                let names = Names::open(&setup)?;
                let place = match program.is_empty() {
                    true => Place::Here(Box::new(SteppedFmu::new(&setup, &Record::default())?)),
                    false => {
                        let session = Session::without_signals()?;
                        let worker = start(&session, &program, &Job::Step(setup))?;
                        Place::There(Box::new(worker), session)
                    }
                };
                anyhow::Ok((names, place))
            })
            .map_err(error)?;
        let mut place = place;
        if let Place::There(worker, _) = &mut place {
            receive(py, worker, &names)?;
        }
        let is_here = program.is_empty();
        let place = ProcessOwned::new(Mutex::new(Some(place)));
        Ok(Self { names, place, is_here, forgotten: Mutex::default() })
    }

    /// The first number of a variable, and the one after its last.
    fn find(&self, name: &str) -> PyResult<(usize, usize)> {
        let found = self.names.find(name).map_err(error)?;
        Ok((found.start, found.end))
    }

    /// Its variables.
    fn variables<'py>(&self, py: Python<'py>) -> PyResult<Vec<Described<'py>>> {
        let described = self.names.variables().iter().map(|variable| {
            let Variable { name, causality, variability, of_type, unit, start, .. } = variable;
            let start = start.iter().map(|value| to_python(py, value.clone()));
            let bound =
                |value: &Option<Value>| value.clone().map(|value| to_python(py, value)).transpose();
            Ok((
                name.clone(),
                causality.as_str(),
                variability.as_str(),
                of_type.as_str(),
                unit.clone().unwrap_or_default(),
                start.collect::<PyResult<_>>()?,
                variable.description.clone(),
                variable.dimensions.clone(),
                bound(&variable.min)?,
                bound(&variable.max)?,
            ))
        });
        described.collect()
    }

    /// The names of its continuous states and their derivatives, and whether it has directional derivatives.
    fn equations(&self) -> (Vec<[String; 2]>, bool) {
        (self.names.states().to_vec(), self.names.is_directional())
    }

    fn initialize<'py>(&self, py: Python<'py>, values: Values<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Initialize(self.typed(values)?))
    }

    /// Checks that values fit their variables.
    fn check(&self, values: Values<'_>) -> PyResult<()> {
        self.typed(values).map(drop)
    }

    fn step<'py>(&self, py: Python<'py>, size: f64) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Step(size))
    }

    fn get<'py>(&self, py: Python<'py>, scalars: Vec<usize>) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Get(scalars))
    }

    fn set<'py>(&self, py: Python<'py>, values: Values<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Set(self.typed(values)?))
    }

    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        // Others may forget states while these are freed.
        let forgotten = std::mem::take(&mut *self.forgotten());
        for state in forgotten {
            self.respond(py, &Request::Forget(state))?;
        }
        self.request(py, Request::Save)
    }

    fn restore<'py>(&self, py: Python<'py>, state: u64) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Restore(state))
    }

    fn reset<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Reset)
    }

    /// Does not wait: the garbage collector may call it while this thread waits for the FMU.
    fn forget(&self, state: u64) {
        self.forgotten().push(state);
    }

    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::States)
    }

    fn set_states<'py>(&self, py: Python<'py>, states: Vec<f64>) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::SetStates(states))
    }

    fn derivatives<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Derivatives)
    }

    fn directional<'py>(
        &self,
        py: Python<'py>,
        unknowns: Vec<usize>,
        knowns: Vec<usize>,
        seed: Vec<f64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.request(py, Request::Directional(unknowns, knowns, seed))
    }

    fn free(&self, py: Python<'_>) {
        if !self.place.is_of_this_process() {
            return;
        }
        let place = self.place(py).take();
        py.detach(|| match place {
            None => {}
            Some(Place::Here(fmu)) => drop(fmu),
            Some(Place::There(mut worker, session)) => {
                // How it ends no longer matters.
                let _ = worker.end(FAREWELL);
                drop(session);
            }
        });
    }
}

/// The time that a worker has to free the FMU.
pub const FAREWELL: Duration = Duration::from_secs(2);
