//! One FMU that Python steps by hand, in a worker process or in this one.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use cargo_fmu::session::Session;
use fmu_description::{Causality, Value, Variable};
use fmu_master::Literal;
use fmu_master::job::Job;
use fmu_master::stepped_fmu::{Names, Request, Response, SteppedFmu};
use fmu_worker::{ProcessOwned, Record};
use pyo3::prelude::*;
use pyo3::sync::{MutexExt, PyOnceLock};
use pyo3::types::{PyBool, PyByteArray, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};

use crate::arguments;
use crate::child::Child;
use crate::error::{FmuError, error, to_exception};
use crate::run::start;
use crate::values::{literal, to_python};

/// Where the FMU is.
enum Place {
    Here(Box<SteppedFmu>, Pace),
    There(Box<Child>),
}

/// Whether steps in this process take so long that Python's lock is worth releasing, which takes about as long as a
/// short step.
struct Pace {
    is_slow: bool,
    steps: u32,
}

impl Pace {
    /// Steps that take longer are slow.
    const SLOW: Duration = Duration::from_micros(10);
    /// One of so many quick steps is measured, as reading the clock takes time, too.
    const MEASURED: u32 = 16;

    /// Calls what takes a step.
    fn step<T: Send>(&mut self, py: Python<'_>, step: impl FnOnce() -> T + Send) -> T {
        self.steps = self.steps.wrapping_add(1);
        if !self.is_slow && !self.steps.is_multiple_of(Self::MEASURED) {
            return step();
        }
        let begin = Instant::now();
        let stepped = if self.is_slow { py.detach(step) } else { step() };
        self.is_slow = begin.elapsed() > Self::SLOW;
        stepped
    }
}

/// An FMU, and what is to be set on it.
struct Fmu {
    /// None when it was freed, or has ended its process.
    place: Option<Place>,
    is_initialized: bool,
    /// Start values by their scalars.
    starts: BTreeMap<usize, Value>,
}

/// An FMU that was instantiated. Variables are scalars or elements, by their numbers.
struct Opened {
    names: Names,
    /// A forked process must not wait for a thread that it does not have.
    fmu: ProcessOwned<Mutex<Fmu>>,
    is_here: bool,
    /// The time that the FMU has reached (s), as bits.
    time: AtomicU64,
    /// States that are no longer needed. The next call of `_save` frees them.
    forgotten: Mutex<Vec<u64>>,
}

/// The native part of `fmu_master.Instance`, with the functions that a loop calls.
#[pyclass(module = "fmu_master._native", subclass, frozen)]
pub struct Instance(OnceLock<Opened>);

impl Opened {
    /// Waits without Python's lock, which the thread that has the FMU needs to return.
    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Fmu>> {
        if !self.is_here && !self.fmu.is_of_this_process() {
            let (name, _) = self.names.names();
            return Err(FmuError::new_err(format!(
                "{name} runs for the process from which this one was forked, expected an Instance that this one has made"
            )));
        }
        Ok(match self.fmu.try_lock() {
            Ok(fmu) => fmu,
            Err(TryLockError::Poisoned(fmu)) => fmu.into_inner(),
            Err(TryLockError::WouldBlock) => {
                self.fmu.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
            }
        })
    }

    fn forgotten(&self) -> MutexGuard<'_, Vec<u64>> {
        self.forgotten.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The FMU, which is initialized, unless it is.
    #[inline]
    fn initialized(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Fmu>> {
        let mut fmu = self.lock(py)?;
        if !fmu.is_initialized {
            let starts = fmu.starts.clone().into_iter().collect();
            self.fulfil(py, &mut fmu, Request::Initialize(starts))?;
        }
        Ok(fmu)
    }

    /// Has a request fulfilled by the FMU, which is initialized first.
    fn request(&self, py: Python<'_>, request: Request) -> PyResult<Response> {
        self.fulfil(py, &mut *self.initialized(py)?, request)
    }

    fn fulfil(&self, py: Python<'_>, fmu: &mut Fmu, request: Request) -> PyResult<Response> {
        let initialized = match request {
            Request::Initialize(_) | Request::Restore(_) => Some(true),
            Request::Reset => Some(false),
            _ => None,
        };
        let response = match fmu.place()? {
            Place::Here(fmu, _) => match request {
                // Not worth releasing the lock of Python, unless the FMU computes for long.
                Request::Initialize(_) | Request::Reset => py.detach(|| fmu.fulfil(&request)),
                _ => fmu.fulfil(&request),
            }
            .map_err(error),
            Place::There(child) => {
                let response = child.request(py, &self.names, request);
                if response.is_err() && child.has_ended() {
                    fmu.place = None;
                }
                response
            }
        }?;
        fmu.is_initialized = initialized.unwrap_or(fmu.is_initialized);
        if let Response::Time(time) = response {
            self.time.store(time.to_bits(), Relaxed);
        }
        Ok(response)
    }

    fn values(&self, py: Python<'_>, scalars: &[usize]) -> PyResult<Vec<Value>> {
        let mut fmu = self.initialized(py)?;
        let response = match fmu.place()? {
            Place::There(child) if !scalars.is_empty() => {
                let got = child.get(py, &self.names, scalars);
                if got.is_err() && child.has_ended() {
                    fmu.place = None;
                }
                return got;
            }
            _ => self.fulfil(py, &mut fmu, Request::Get(scalars.to_vec()))?,
        };
        match response {
            Response::Values(values) => Ok(values),
            _ => Ok(Vec::new()),
        }
    }

    /// The value of a variable in its type.
    fn typed(&self, name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<(usize, Value)>> {
        match plain(value)? {
            Some(literal) => self.names.typed(name, &literal).map_err(error),
            None => {
                let shown = value.repr()?.to_string();
                Err(self.names.refusal(name, &shown).map_or_else(error, error))
            }
        }
    }

    fn typed_all(&self, values: &Bound<'_, PyAny>) -> PyResult<Vec<(usize, Value)>> {
        let py = values.py();
        let values = helper(py, "named")?.call1((values,))?.cast_into::<PyDict>()?;
        let mut typed = Vec::with_capacity(values.len());
        for (name, value) in values {
            typed.extend(self.typed(name.cast::<PyString>()?.to_str()?, &value)?);
        }
        Ok(typed)
    }

    /// Start values, which do not change the sizes of arrays.
    fn start_values(
        &self,
        fmu: &Fmu,
        values: Vec<(usize, Value)>,
    ) -> PyResult<Vec<(usize, Value)>> {
        for (scalar, value) in &values {
            let variable = self.names.variable(*scalar);
            let is_size = variable.causality == Causality::StructuralParameter;
            if is_size && fmu.starts.get(scalar) != Some(value) {
                let text = "is a structural parameter, expected in `start_values` of an Instance";
                return Err(FmuError::new_err(format!("{} {text}", variable.name)));
            }
        }
        Ok(values)
    }

    fn set(&self, py: Python<'_>, values: Vec<(usize, Value)>) -> PyResult<()> {
        let mut fmu = self.lock(py)?;
        if !fmu.is_initialized {
            let starts = self.start_values(&fmu, values)?;
            fmu.starts.extend(starts);
            return Ok(());
        }
        if let Place::There(child) = fmu.place()?
            && values.iter().all(|(scalar, value)| self.names.is_accepted(*scalar, value))
        {
            child.set_later(values);
            return Ok(());
        }
        self.fulfil(py, &mut fmu, Request::Set(values)).map(drop)
    }

    /// The numbers of all scalars and elements of these names.
    fn scalars(&self, names: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
        let mut scalars = Vec::new();
        for name in names.try_iter()? {
            let name = name?;
            scalars.extend(self.names.find(name.cast::<PyString>()?.to_str()?).map_err(error)?);
        }
        Ok(scalars)
    }
}

impl Fmu {
    #[inline]
    fn place(&mut self) -> PyResult<&mut Place> {
        self.place.as_mut().ok_or_else(|| error(anyhow!("the instance was freed")))
    }
}

/// A function of the package for values.
fn helper<'py>(py: Python<'py>, name: &'static str) -> PyResult<Bound<'py, PyAny>> {
    static MODULE: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let module = MODULE.get_or_try_init(py, || {
        PyResult::Ok(py.import("fmu_master._values")?.into_any().unbind())
    })?;
    module.bind(py).getattr(name)
}

/// A value without NumPy; `None` if no variable has one of its type.
fn plain(value: &Bound<'_, PyAny>) -> PyResult<Option<Literal>> {
    let is_plain = value.is_instance_of::<PyFloat>()
        || value.is_instance_of::<PyInt>()
        || value.is_instance_of::<PyString>();
    let plain;
    let value = match is_plain {
        true => value,
        false => {
            plain = helper(value.py(), "plain")?.call1((value,))?;
            &plain
        }
    };
    Ok(literal(value).ok())
}

/// A float, or an integer that one takes the place of.
#[inline]
fn float(value: &Bound<'_, PyAny>) -> Option<f64> {
    if let Ok(value) = value.cast::<PyFloat>() {
        return Some(value.value());
    }
    let is_integer = value.is_instance_of::<PyInt>() && !value.is_instance_of::<PyBool>();
    if is_integer { value.extract().ok() } else { None }
}

/// Values as an array of NumPy, in this shape unless it has one dimension.
fn array<'py>(
    py: Python<'py>,
    values: Vec<Value>,
    shape: Option<&[usize]>,
) -> PyResult<Bound<'py, PyAny>> {
    let bytes = values.iter().map(|value| match value {
        Value::Float64(value) => Some(value.to_ne_bytes()),
        _ => None,
    });
    let found = match bytes.collect::<Option<Vec<_>>>() {
        Some(bytes) => {
            let bytes = PyByteArray::new(py, bytes.as_flattened());
            helper(py, "floats")?.call1((bytes,))?
        }
        None => helper(py, "array")?.call1((list(py, values)?,))?,
    };
    match shape {
        Some(shape) if shape.len() != 1 => {
            found.call_method1("reshape", (PyTuple::new(py, shape)?,))
        }
        _ => Ok(found),
    }
}

fn list(py: Python<'_>, values: Vec<Value>) -> PyResult<Bound<'_, PyList>> {
    let values = values.into_iter().map(|value| to_python(py, value));
    PyList::new(py, values.collect::<PyResult<Vec<_>>>()?)
}

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

impl Instance {
    #[inline]
    fn opened(&self) -> PyResult<&Opened> {
        let text = "Instance.__init__ was not called";
        self.0.get().ok_or_else(|| error(anyhow!(text)))
    }
}

#[pymethods]
impl Instance {
    /// A class in Python may have other arguments; it calls `_open`.
    #[new]
    #[pyo3(signature = (*_arguments, **_options))]
    fn new(_arguments: &Bound<'_, PyTuple>, _options: Option<&Bound<'_, PyDict>>) -> Self {
        Self(OnceLock::new())
    }

    /// Instantiates an FMU, in this process unless `program` starts a worker process.
    fn _open(
        &self,
        py: Python<'_>,
        setup: &Bound<'_, PyDict>,
        starts: &Bound<'_, PyAny>,
        program: Vec<OsString>,
    ) -> PyResult<()> {
        let setup = arguments::setup(setup)?;
        let time = AtomicU64::new(setup.start.to_bits());
        let (names, mut place) = py
            .detach(|| {
                let names = Names::open(&setup)?;
                let place = match program.is_empty() {
                    true => Place::Here(
                        Box::new(SteppedFmu::new(&setup, &Record::default())?),
                        Pace { is_slow: true, steps: 0 },
                    ),
                    false => {
                        let session = Session::without_signals()?;
                        let worker = start(&session, &program, &Job::Step(setup))?;
                        Place::There(Box::new(Child::new(worker, session)))
                    }
                };
                anyhow::Ok((names, place))
            })
            .map_err(error)?;
        if let Place::There(child) = &mut place
            && let Some(failure) = child.receive(py, &names)?.failure
        {
            return Err(to_exception(*failure));
        }
        let fmu = Fmu { place: Some(place), is_initialized: false, starts: BTreeMap::new() };
        let opened = Opened {
            names,
            fmu: ProcessOwned::new(Mutex::new(fmu)),
            is_here: program.is_empty(),
            time,
            forgotten: Mutex::default(),
        };
        let starts = opened.typed_all(starts)?;
        opened.lock(py)?.starts.extend(starts);
        self.0.set(opened).map_err(|_| error(anyhow!("Instance.__init__ was called before")))
    }

    /// The time that the FMU has reached [s].
    #[getter]
    fn time(&self) -> PyResult<f64> {
        Ok(f64::from_bits(self.opened()?.time.load(Relaxed)))
    }

    /// Its variables.
    fn _variables<'py>(&self, py: Python<'py>) -> PyResult<Vec<Described<'py>>> {
        let described = self.opened()?.names.variables().iter().map(|variable| {
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
    fn _equations(&self) -> PyResult<(Vec<[String; 2]>, bool)> {
        let names = &self.opened()?.names;
        Ok((names.states().to_vec(), names.is_directional()))
    }

    /// The start values by name, those of an array as a list; None if it is initialized.
    fn _starts<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let opened = self.opened()?;
        let fmu = opened.lock(py)?;
        let starts = match fmu.is_initialized {
            true => return Ok(None),
            false => fmu.starts.clone(),
        };
        drop(fmu);
        let named = PyDict::new(py);
        for Variable { name, dimensions, .. } in opened.names.variables() {
            let scalars = opened.names.find(name).map_err(error)?;
            let values = scalars.map(|scalar| starts.get(&scalar).cloned());
            let Some(values) = values.collect::<Option<Vec<_>>>() else { continue };
            let values = list(py, values)?;
            match dimensions.is_empty() {
                true => named.set_item(name, values.get_item(0)?)?,
                false => named.set_item(name, values)?,
            }
        }
        Ok(Some(named))
    }

    fn _initialize(&self, py: Python<'_>) -> PyResult<()> {
        self.opened()?.initialized(py).map(drop)
    }

    /// Step by a time [s].
    fn step(&self, py: Python<'_>, step_size: f64) -> PyResult<()> {
        let opened = self.opened()?;
        let mut fmu = opened.initialized(py)?;
        let Place::Here(here, pace) = fmu.place()? else {
            return opened.fulfil(py, &mut fmu, Request::Step(step_size)).map(drop);
        };
        let time = pace.step(py, || here.step(step_size)).map_err(error)?;
        opened.time.store(time.to_bits(), Relaxed);
        Ok(())
    }

    /// Return the value of a variable, or an array of the values of several.
    ///
    /// A value is a float, int, bool, str or bytes, as the variable, or an array in its shape. The
    /// values of several variables follow each other in one dimension.
    fn get<'py>(&self, py: Python<'py>, names: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let opened = self.opened()?;
        let Ok(name) = names.cast::<PyString>() else {
            let scalars = opened.scalars(names)?;
            return array(py, opened.values(py, &scalars)?, None);
        };
        let name = name.to_str()?;
        if opened.is_here
            && let Some(scalar) = opened.names.float64(name)
        {
            let value = match opened.initialized(py)?.place()? {
                Place::Here(fmu, _) => fmu.get_float64(scalar).map_err(error)?,
                Place::There(_) => f64::NAN,
            };
            return Ok(PyFloat::new(py, value).into_any());
        }
        let scalars = opened.names.find(name).map_err(error)?;
        let values = opened.values(py, &Vec::from_iter(scalars))?;
        match opened.names.shape(name) {
            Some(shape) => array(py, values, Some(shape)),
            None => to_python(py, values.into_iter().next().context("no value").map_err(error)?),
        }
    }

    fn _get_list<'py>(
        &self,
        py: Python<'py>,
        names: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyList>> {
        let opened = self.opened()?;
        let scalars = opened.scalars(names)?;
        list(py, opened.values(py, &scalars)?)
    }

    /// Set a variable, or all variables of a mapping; before initialization, start values.
    ///
    /// A value has the type of its variable: a number (also a whole number for a float), a bool, a
    /// str, the name or the number of an item, or an array in the shape of the variable. In a child
    /// process, an input or tunable parameter within its bounds is set by the next call that needs
    /// the FMU, which then raises the error if the FMU refuses the value.
    #[pyo3(signature = (name, value = None))]
    fn set(
        &self,
        py: Python<'_>,
        name: &Bound<'_, PyAny>,
        value: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let opened = self.opened()?;
        let Ok(text) = name.cast::<PyString>() else {
            return opened.set(py, opened.typed_all(name)?);
        };
        let text = text.to_str()?;
        if let Some(number) = value.and_then(float)
            && let Some(scalar) = opened.names.float64(text)
        {
            let mut fmu = opened.lock(py)?;
            if fmu.is_initialized
                && let Place::Here(fmu, _) = fmu.place()?
            {
                return fmu.set_float64(scalar, number).map_err(error);
            }
            drop(fmu);
            return opened.set(py, vec![(scalar, Value::Float64(number))]);
        }
        let none = py.None().into_bound(py);
        let typed = opened.typed(text, value.unwrap_or(&none))?;
        opened.set(py, typed)
    }

    fn _reset(&self, py: Python<'_>, starts: &Bound<'_, PyAny>) -> PyResult<()> {
        let opened = self.opened()?;
        let starts = opened.typed_all(starts)?;
        let mut fmu = opened.lock(py)?;
        let starts = opened.start_values(&fmu, starts)?;
        if let Place::There(child) = fmu.place()? {
            child.forget_waiting();
        }
        opened.fulfil(py, &mut fmu, Request::Reset)?;
        fmu.starts.extend(starts);
        Ok(())
    }

    /// The number of a saved state.
    fn _save(&self, py: Python<'_>) -> PyResult<u64> {
        let opened = self.opened()?;
        // Others may forget states while these are freed.
        let forgotten = std::mem::take(&mut *opened.forgotten());
        for state in forgotten {
            opened.request(py, Request::Forget(state))?;
        }
        match opened.request(py, Request::Save)? {
            Response::Saved(number) => Ok(number),
            _ => Err(error(anyhow!("the state was not saved"))),
        }
    }

    fn _restore(&self, py: Python<'_>, state: u64) -> PyResult<()> {
        let opened = self.opened()?;
        opened.fulfil(py, &mut *opened.lock(py)?, Request::Restore(state)).map(drop)
    }

    /// Does not wait: the garbage collector may call it while this thread waits for the FMU.
    fn _forget(&self, state: u64) -> PyResult<()> {
        self.opened()?.forgotten().push(state);
        Ok(())
    }

    fn _states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.numbers(py, Request::States)
    }

    fn _set_states(&self, py: Python<'_>, states: Vec<f64>) -> PyResult<()> {
        self.opened()?.request(py, Request::SetStates(states)).map(drop)
    }

    fn _derivatives<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.numbers(py, Request::Derivatives)
    }

    fn _directional<'py>(
        &self,
        py: Python<'py>,
        unknowns: &Bound<'py, PyAny>,
        knowns: &Bound<'py, PyAny>,
        seed: Vec<f64>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let opened = self.opened()?;
        let (unknowns, knowns) = (opened.scalars(unknowns)?, opened.scalars(knowns)?);
        self.numbers(py, Request::Directional(unknowns, knowns, seed))
    }

    /// End and free the FMU.
    fn free(&self, py: Python<'_>) -> PyResult<()> {
        let Some(opened) = self.0.get().filter(|opened| opened.fmu.is_of_this_process()) else {
            return Ok(());
        };
        let place = opened.lock(py)?.place.take();
        py.detach(|| match place {
            None => {}
            Some(Place::Here(fmu, _)) => drop(fmu),
            Some(Place::There(child)) => child.end(),
        });
        Ok(())
    }
}

impl Instance {
    fn numbers<'py>(&self, py: Python<'py>, request: Request) -> PyResult<Bound<'py, PyAny>> {
        match self.opened()?.request(py, request)? {
            Response::Numbers(numbers) => {
                let values = numbers.into_iter().map(Value::Float64).collect();
                array(py, values, None)
            }
            other => Err(error(anyhow!("{other:?}, expected numbers"))),
        }
    }
}
