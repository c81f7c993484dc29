//! Instances of an FMU that are stepped together, in worker processes or in threads of this one. Numbers go from and to arrays
//! of NumPy.

use std::ffi::OsString;
use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

use anyhow::{Context, Result, ensure};
use cargo_fmu::session::Session;
use fmu_description::{Causality, Type, Value};
use fmu_master::job::{self, Job};
use fmu_master::stepped_fmu::{Names, Setup};
use fmu_master::vector::{Exchange, Share, ShareSource, Task, VectorSetup, action_value};
use fmu_worker::{ProcessOwned, Record};
use pyo3::buffer::PyBuffer;
use pyo3::exceptions::{PyIndexError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::PyDict;

use crate::arguments::{self, Starts};
use crate::caller::{Caller, ShareThread};
use crate::child::FAREWELL;
use crate::error::{FmuError, error};
use crate::run::{command, limits};
use crate::values::literal;

/// A share of the instances, and the memory of their numbers.
struct Part {
    caller: Caller,
    exchange: Exchange,
    /// Whether it has a task.
    is_busy: bool,
}

/// The episode of an instance.
#[derive(Clone, Default)]
struct Episode {
    has_begun: bool,
    /// Whether the next step leaves it out.
    is_held: bool,
    steps: u64,
    time: f64,
}

/// What changes.
struct State {
    /// In the order of the shares. One is missing before its first task, and after a failure in its process.
    parts: Vec<Option<Part>>,
    episodes: Vec<Episode>,
    /// Dropped after the workers.
    session: Option<Session>,
    /// How many workers were started.
    started: usize,
    is_freed: bool,
    /// The numbers that NumPy's arrays get and have.
    actions: Vec<f64>,
    observations: Vec<f64>,
    times: Vec<f64>,
    ends: Vec<u8>,
}

/// A variable of an action or observation: its name, its smallest and its largest value.
type Bound = (String, f64, f64);

/// Instances of an FMU, by their numbers.
#[pyclass(module = "fmu_master._native")]
pub struct Vector {
    names: Names,
    setup: VectorSetup,
    /// Of each observation.
    bounds: Vec<[f64; 2]>,
    /// The number of steps of an episode.
    steps: u64,
    program: Vec<OsString>,
    shares: Vec<Range<usize>>,
    /// A forked process must not wait for a thread that it does not have.
    state: ProcessOwned<Mutex<State>>,
}

/// The FMU, with the sizes of arrays among the start values.
fn open(setup: &mut Setup) -> Result<Names> {
    let given = std::mem::take(&mut setup.sizes);
    let names = Names::open(setup)?;
    let sizes = structural(&names);
    setup.sizes = given.into_iter().filter(|(name, _)| sizes.contains(name)).collect();
    if setup.sizes.is_empty() { Ok(names) } else { Names::open(setup) }
}

fn structural(names: &Names) -> Vec<String> {
    let variables = names.variables().iter();
    let sizes = variables.filter(|v| v.causality == Causality::StructuralParameter);
    sizes.map(|variable| variable.name.clone()).collect()
}

/// The number of a variable with one element that is a number.
fn scalar(names: &Names, name: &str) -> Result<usize> {
    let found = names.find(name)?;
    let kind = names.variable(found.start).of_type;
    ensure!(found.len() == 1, "{name} is an array, expected one of its {} elements", found.len());
    ensure!(
        !matches!(kind, Type::String | Type::Binary | Type::Clock),
        "{name} is a {}, expected a number",
        kind.as_str()
    );
    Ok(found.start)
}

/// Start values in the types of their variables.
fn typed(names: &Names, values: &Starts<'_>) -> PyResult<Vec<(usize, Value)>> {
    let mut typed = Vec::with_capacity(values.len());
    for (name, value) in values {
        typed.extend(names.typed(name, &literal(value)?).map_err(error)?);
    }
    Ok(typed)
}

#[pymethods]
impl Vector {
    /// `count` instances of an FMU, in this process unless `program` starts worker processes. They are split among so many
    /// `processes` or threads; 0 are as many as the machine has cores.
    #[new]
    #[pyo3(signature = (setup, program, count, processes, actions, observations, step, steps))]
    #[allow(clippy::too_many_arguments, reason = "called once, by the package")]
    fn new(
        py: Python<'_>,
        setup: &pyo3::Bound<'_, PyDict>,
        program: Vec<OsString>,
        count: usize,
        processes: usize,
        actions: Vec<String>,
        observations: Vec<Bound>,
        step: f64,
        steps: u64,
    ) -> PyResult<Self> {
        let mut fmu = arguments::setup(setup)?;
        let names = py.detach(|| open(&mut fmu)).map_err(error)?;
        let find = |name: &String| scalar(&names, name).map_err(error);
        let actions = actions.iter().map(find).collect::<PyResult<_>>()?;
        let observed = observations.iter().map(|(name, ..)| find(name));
        let setup = VectorSetup {
            fmu,
            count,
            actions,
            observations: observed.collect::<PyResult<_>>()?,
            step,
        };
        let cores = || thread::available_parallelism().map_or(1, usize::from);
        let shares = if processes == 0 { cores() } else { processes }.clamp(1, count.max(1));
        let is_crowded = if program.is_empty() { count > 1 } else { count > shares };
        if names.is_single() && is_crowded {
            let (_, file) = names.names();
            return Err(FmuError::new_err(format!(
                "{file} allows only one instance in a process, expected processes = {count}, without in_process"
            )));
        }
        let shares =
            Vec::from_iter((0..shares).map(|n| n * count / shares..(n + 1) * count / shares));
        let state = State {
            parts: shares.iter().map(|_| None).collect(),
            episodes: vec![Episode::default(); count],
            session: None,
            started: 0,
            is_freed: false,
            actions: vec![0.0; count * setup.actions.len()],
            observations: vec![0.0; count * observations.len()],
            times: vec![0.0; count],
            ends: vec![0; 2 * count],
        };
        Ok(Self {
            bounds: observations.into_iter().map(|(_, low, high)| [low, high]).collect(),
            state: ProcessOwned::new(Mutex::new(state)),
            names,
            setup,
            steps,
            program,
            shares,
        })
    }

    /// The names of the structural parameters. An instance keeps the sizes with which it was made.
    fn structural(&self) -> Vec<String> {
        structural(&self.names)
    }

    /// Begins episodes of instances, by their numbers, with these start values. If they are held, the next step leaves
    /// them as they are.
    fn reset(
        &self,
        py: Python<'_>,
        episodes: Vec<(usize, Starts<'_>)>,
        holds: bool,
    ) -> PyResult<()> {
        let mut state = self.state(py)?;
        let mut tasks = vec![Vec::new(); self.shares.len()];
        for (number, starts) in &episodes {
            let share = self.shares.partition_point(|numbers| numbers.end <= *number);
            let numbers = self.shares.get(share);
            let place = number - numbers.ok_or_else(|| PyIndexError::new_err(*number))?.start;
            tasks[share].push((place, typed(&self.names, starts)?));
        }
        let mut tasks =
            tasks.into_iter().map(|task| (!task.is_empty()).then_some(Task::Reset(task)));
        self.perform(py, &mut state, || tasks.next().flatten())?;
        for (number, _) in episodes {
            let time = self.setup.fmu.start;
            state.episodes[number] = Episode { has_begun: true, is_held: holds, steps: 0, time };
        }
        Ok(())
    }

    /// Steps all instances that are not held, and writes their observations, times (s), and whether they are terminated and
    /// truncated. Returns whether an episode is over.
    fn step(
        &self,
        py: Python<'_>,
        actions: PyBuffer<f64>,
        observations: PyBuffer<f64>,
        times: PyBuffer<f64>,
        ends: PyBuffer<u8>,
    ) -> PyResult<bool> {
        let mut state = self.state(py)?;
        actions.copy_to_slice(py, &mut state.actions)?;
        self.check(&state)?;
        let width = self.setup.actions.len();
        for (numbers, part) in self.shares.iter().zip(&state.parts) {
            let Some(Part { exchange, .. }) = part else { continue };
            for number in numbers.clone() {
                let action = state.actions[number * width..].iter().copied();
                let action = (!state.episodes[number].is_held).then_some(action);
                exchange.set_action(number - numbers.start, action);
            }
        }
        self.perform(py, &mut state, || Some(Task::Step))?;
        for episode in &mut state.episodes {
            if !std::mem::take(&mut episode.is_held) {
                (episode.steps, episode.time) = (episode.steps + 1, episode.time + self.setup.step);
            }
        }
        self.write(py, &mut state, &observations, &times)?;
        let State { observations: observed, episodes, ends: written, .. } = &mut *state;
        let (terminations, truncations) = written.split_at_mut(episodes.len());
        for (number, episode) in episodes.iter().enumerate() {
            let has_stepped = episode.steps > 0;
            let observation = observed[number * self.bounds.len()..].iter().zip(&self.bounds);
            let mut within = observation.map(|(x, [low, high])| low <= x && x <= high);
            terminations[number] = (has_stepped && !within.all(|within| within)).into();
            truncations[number] = (has_stepped && episode.steps >= self.steps).into();
        }
        ends.copy_from_slice(py, written)?;
        Ok(written.contains(&1))
    }

    /// Writes the observations of all instances, and their times (s).
    fn observe(
        &self,
        py: Python<'_>,
        observations: PyBuffer<f64>,
        times: PyBuffer<f64>,
    ) -> PyResult<()> {
        let mut state = self.state(py)?;
        self.write(py, &mut state, &observations, &times)
    }

    /// Frees the instances.
    fn free(&self, py: Python<'_>) {
        let Ok(mut state) = self.state(py) else { return };
        state.is_freed = true;
        let parts = state.parts.iter_mut().filter_map(Option::take).collect();
        let session = state.session.take();
        py.detach(|| end(parts, session));
    }
}

/// Ends the callers of shares.
fn end(parts: Vec<Part>, session: Option<Session>) {
    let mut workers = Vec::new();
    for part in parts {
        if let Caller::Process(mut worker) = part.caller {
            worker.dismiss();
            workers.push(worker);
        }
    }
    // How they end no longer matters.
    for mut worker in workers {
        let _ = worker.end(FAREWELL);
    }
    drop(session);
}

impl Vector {
    /// Waits without Python's lock, which the thread that has the instances needs to return.
    fn state(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, State>> {
        if !self.state.is_of_this_process() {
            let (name, _) = self.names.names();
            return Err(FmuError::new_err(format!(
                "{name} runs for the process from which this one was forked, expected an environment that this one has made"
            )));
        }
        let state = self.state.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner);
        match state.is_freed {
            true => Err(PyRuntimeError::new_err("the environment is closed")),
            false => Ok(state),
        }
    }

    /// Checks that all instances have an episode, and an action unless they are held.
    fn check(&self, state: &State) -> PyResult<()> {
        let is_alone = self.setup.count == 1;
        let variables = &self.setup.actions;
        let actions = state.actions.chunks(variables.len());
        for (number, (episode, action)) in state.episodes.iter().zip(actions).enumerate() {
            if !episode.has_begun {
                let which =
                    if is_alone { "the environment" } else { &format!("environment {number}") };
                return Err(PyRuntimeError::new_err(format!(
                    "{which} has no episode, expected a call of reset first"
                )));
            }
            for (variable, value) in variables.iter().zip(action) {
                let is_plain = self.names.variable(*variable).of_type == Type::Float64;
                if episode.is_held || (is_plain && value.is_finite()) {
                    continue;
                }
                action_value(&self.names, *variable, *value).map_err(|error| {
                    let of = if is_alone { "" } else { &format!("environment {number}: ") };
                    PyValueError::new_err(format!("{of}{error}"))
                })?;
            }
        }
        Ok(())
    }

    fn write(
        &self,
        py: Python<'_>,
        state: &mut State,
        observations: &PyBuffer<f64>,
        times: &PyBuffer<f64>,
    ) -> PyResult<()> {
        let width = self.bounds.len();
        for (numbers, part) in self.shares.iter().zip(&state.parts) {
            let Some(Part { exchange, .. }) = part else { continue };
            for number in numbers.clone() {
                let observation = exchange.observation(number - numbers.start);
                let places = &mut state.observations[number * width..];
                places.iter_mut().zip(observation).for_each(|(to, value)| *to = value);
            }
        }
        let now = state.episodes.iter().map(|episode| episode.time);
        state.times.iter_mut().zip(now).for_each(|(to, time)| *to = time);
        observations.copy_from_slice(py, &state.observations)?;
        times.copy_from_slice(py, &state.times)
    }

    /// Has each share do its task, and waits for all. After a failure, no instance has an episode.
    fn perform(
        &self,
        py: Python<'_>,
        state: &mut State,
        task: impl FnMut() -> Option<Task> + Send,
    ) -> PyResult<()> {
        let performed = py.detach(|| self.perform_detached(state, task));
        if performed.is_err() {
            state.episodes.iter_mut().for_each(|episode| episode.has_begun = false);
        }
        performed
    }

    fn perform_detached(
        &self,
        state: &mut State,
        mut task: impl FnMut() -> Option<Task>,
    ) -> PyResult<()> {
        let mut outcome = Ok(());
        for share in 0..self.shares.len() {
            let Some(task) = task() else { continue };
            if state.parts[share].is_none() {
                match self.start(share, state) {
                    Ok(part) => state.parts[share] = Some(part),
                    Err(failure) => outcome = outcome.and(Err(error(failure))),
                }
            }
            if let Some(part) = &mut state.parts[share] {
                part.caller.send(task);
                part.is_busy = true;
            }
        }
        let names = || {
            let (name, file) = self.names.names();
            let all = (0..self.setup.count).map(|number| self.setup.name(&name, number));
            all.map(|name| (name, file.clone())).collect()
        };
        for part in &mut state.parts {
            let Some(Part { caller, is_busy, .. }) = part else { continue };
            if std::mem::take(is_busy) {
                let done = caller.receive(names);
                if done.is_err() && matches!(caller, Caller::Process(_)) {
                    *part = None;
                }
                outcome = outcome.and(done);
            }
        }
        outcome
    }

    fn start(&self, share: usize, state: &mut State) -> Result<Part> {
        let numbers = self.shares[share].clone();
        if self.program.is_empty() {
            let exchange = Exchange::private(&self.setup, numbers.len())?;
            let (setup, record) = (&self.setup, Record::default());
            let instances = Share::new(&self.names, setup, numbers, exchange.clone(), record);
            let caller = match share {
                0 => Caller::Receiver(Box::new(instances), None),
                _ => Caller::Thread(ShareThread::new(instances)),
            };
            return Ok(Part { caller, exchange, is_busy: false });
        }
        let session = match &mut state.session {
            Some(session) => session,
            none => none.insert(Session::without_signals()?),
        };
        let file = session.folder().join(format!("exchange-{}", state.started));
        state.started += 1;
        let exchange = Exchange::create(&self.setup, numbers.len(), &file)?;
        let source = ShareSource { vector: self.setup.clone(), numbers, exchange: file };
        let (job, limits) = (Job::Vector(source), limits(self.shares.len()));
        let worker = job::start(&mut command(&self.program), session.folder(), limits, &job);
        let worker = worker.context("cannot start a worker process")?;
        Ok(Part { caller: Caller::Process(Box::new(worker)), exchange, is_busy: false })
    }
}
