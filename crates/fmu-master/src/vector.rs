//! Instances of an FMU that are stepped together, such as the environments of a learner. They are split into shares, each in
//! a thread or a worker process of its own, where [`serve`] does the tasks of the supervisor.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use anyhow::{Result, ensure};
use fmu_description::{Type, Value};
use fmu_host::SharedMemory;
use fmu_worker::{Record, Service};
use serde::{Deserialize, Serialize};

use crate::components::LoadedComponent;
use crate::cycle::Cycle;
use crate::stepped_fmu::{Names, Request, Response, Setup, SteppedFmu};
use crate::store::number;
use crate::{Literal, Messages, RunError};

/// The instances, and what each step of them accesses. Variables are scalars, by their numbers in [`Names`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct VectorSetup {
    /// The FMU.
    pub fmu: Setup,
    /// The number of instances.
    pub count: usize,
    /// The variables that are set before a step.
    pub actions: Vec<usize>,
    /// The variables that are got after a step.
    pub observations: Vec<usize>,
    /// The size of a step (s).
    pub step: f64,
}

impl VectorSetup {
    /// The name of an instance with a number, for an FMU of this name.
    pub fn name(&self, name: &str, number: usize) -> String {
        if self.count == 1 { name.to_owned() } else { format!("{name}[{number}]") }
    }
}

/// A share of the instances, for a worker process.
#[derive(Debug, Serialize, Deserialize)]
pub struct ShareSource {
    /// All instances.
    pub vector: VectorSetup,
    /// The numbers of its instances.
    pub numbers: Range<usize>,
    /// The file of [`Exchange::create`].
    pub exchange: PathBuf,
}

/// A task of a share.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum Task {
    /// To begin episodes of instances, by their places in the share, with these start values.
    Reset(Vec<(usize, Vec<(usize, Value)>)>),
    /// To step all instances that have an action.
    Step,
}

/// The result of a task: the first failure of an instance.
pub type Outcome = Result<(), Box<RunError>>;

/// The actions and observations of a share, in memory that the supervisor and the share have in common.
#[derive(Debug, Clone)]
pub struct Exchange {
    memory: SharedMemory,
    actions: usize,
    observations: usize,
}

/// Of each instance: whether it has an action, the action, and the observation.
const ACTION: usize = 1;

impl Exchange {
    fn new(
        setup: &VectorSetup,
        instances: usize,
        memory: impl FnOnce(usize) -> io::Result<SharedMemory>,
    ) -> io::Result<Self> {
        let (actions, observations) = (setup.actions.len(), setup.observations.len());
        let words = (ACTION + actions + observations) * instances;
        let memory = memory(words)?;
        match memory.words().len() >= words {
            true => Ok(Self { memory, actions, observations }),
            false => Err(io::Error::other("it is too short for its instances")),
        }
    }

    /// Of this many instances, for a thread of this process.
    ///
    /// # Errors
    /// None.
    pub fn private(setup: &VectorSetup, instances: usize) -> io::Result<Self> {
        Self::new(setup, instances, |words| Ok(SharedMemory::private(words)))
    }

    /// Of this many instances, in a new file for another process.
    ///
    /// # Errors
    /// The file cannot be written or mapped.
    pub fn create(setup: &VectorSetup, instances: usize, file: &Path) -> io::Result<Self> {
        Self::new(setup, instances, |words| SharedMemory::create(file, words.max(2)))
    }

    fn open(source: &ShareSource) -> io::Result<Self> {
        let memory = |_| SharedMemory::open(&source.exchange);
        Self::new(&source.vector, source.numbers.len(), memory)
    }

    fn row(&self, instance: usize) -> &[AtomicU64] {
        let length = ACTION + self.actions + self.observations;
        &self.memory.words()[instance * length..][..length]
    }

    /// Sets the action of an instance for the next step; without one, the step leaves the instance out.
    pub fn set_action(&self, instance: usize, action: Option<impl Iterator<Item = f64>>) {
        let (is_given, rest) = self.row(instance).split_at(ACTION);
        is_given[0].store(action.is_some().into(), Relaxed);
        for (word, value) in rest.iter().zip(action.into_iter().flatten().take(self.actions)) {
            word.store(value.to_bits(), Relaxed);
        }
    }

    /// Gets the action of an instance; false if it has none.
    fn action(&self, instance: usize, action: &mut [f64]) -> bool {
        let (is_given, rest) = self.row(instance).split_at(ACTION);
        for (value, word) in action.iter_mut().zip(rest) {
            *value = f64::from_bits(word.load(Relaxed));
        }
        is_given[0].load(Relaxed) != 0
    }

    /// The observation of an instance.
    pub fn observation(&self, instance: usize) -> impl Iterator<Item = f64> {
        let words = self.row(instance)[ACTION + self.actions..].iter();
        words.map(|word| f64::from_bits(word.load(Relaxed)))
    }

    fn set_observation(&self, instance: usize, observation: &[f64]) {
        let words = &self.row(instance)[ACTION + self.actions..];
        for (word, value) in words.iter().zip(observation) {
            word.store(value.to_bits(), Relaxed);
        }
    }
}

/// A number as the value of a variable that is an action.
///
/// # Errors
/// The number is not finite, or the variable is of another type, such as an integer, and the number does not fit.
pub fn action_value(names: &Names, scalar: usize, number: f64) -> Result<Value> {
    typed(names.component(), scalar, number)
}

fn typed(planned: &LoadedComponent, scalar: usize, number: f64) -> Result<Value> {
    let (variable, name) = (planned.fmu.variable(scalar), planned.fmu.name(scalar));
    ensure!(number.is_finite(), "{name} = {number}, expected a finite number");
    let is_whole = number.fract() == 0.0 && number.abs() < 2f64.powi(63);
    let literal = match variable.of_type {
        Type::Boolean if number == 0.0 || number == 1.0 => Literal::Boolean(number == 1.0),
        kind if !kind.is_float() && is_whole => Literal::Integer(number as i128),
        _ => Literal::Real(number),
    };
    literal.typed(variable, &name)
}

/// Instances that are called by one thread.
pub struct Share {
    planned: LoadedComponent,
    setup: VectorSetup,
    /// The number of the first instance.
    first: usize,
    /// Where all are Float64, and the FMU takes steps itself.
    cycle: Option<Cycle>,
    exchange: Exchange,
    messages: Messages,
    /// An instance exists from its first episode until it fails.
    instances: Vec<Option<SteppedFmu>>,
    action: Vec<f64>,
    observation: Vec<f64>,
}

impl Share {
    /// The instances with these numbers, whose calls are recorded.
    pub fn new(
        names: &Names,
        setup: &VectorSetup,
        numbers: Range<usize>,
        exchange: Exchange,
        record: Record,
    ) -> Self {
        let planned = names.component().clone();
        Self {
            cycle: Cycle::new(&planned.fmu, &setup.actions, &setup.observations),
            first: numbers.start,
            exchange,
            messages: Messages::of_problems(record),
            instances: numbers.map(|_| None).collect(),
            action: vec![0.0; setup.actions.len()],
            observation: vec![0.0; setup.observations.len()],
            setup: setup.clone(),
            planned,
        }
    }

    /// Does a task. An instance that fails does not keep the others from it.
    ///
    /// # Errors
    /// The first failure of an instance, which no longer exists until it is reset.
    pub fn fulfil(&mut self, task: &Task) -> Outcome {
        let mut outcome = Ok(());
        let mut attempt = |share: &mut Self, place, attempted: Result<()>| {
            if let Err(error) = attempted {
                share.instances[place] = None;
                if outcome.is_ok() {
                    outcome = Err(RunError::new(error, Vec::new()));
                }
            }
        };
        match task {
            Task::Reset(episodes) => {
                for (place, starts) in episodes {
                    let begun = self.reset(*place, starts);
                    attempt(self, *place, begun);
                }
            }
            Task::Step => {
                for place in 0..self.instances.len() {
                    let stepped = self.step(place);
                    attempt(self, place, stepped);
                }
            }
        }
        outcome
    }

    fn reset(&mut self, place: usize, starts: &[(usize, Value)]) -> Result<()> {
        let last = self.instances[place].take();
        let last = last.and_then(|mut fmu| fmu.fulfil(&Request::Reset).is_ok().then_some(fmu));
        let mut fmu = match last {
            Some(fmu) => fmu,
            None => self.instantiate(place)?,
        };
        fmu.fulfil(&Request::Initialize(starts.to_vec()))?;
        get(&mut fmu, &self.setup, &mut self.observation)?;
        self.exchange.set_observation(place, &self.observation);
        self.instances[place] = Some(fmu);
        Ok(())
    }

    fn instantiate(&self, place: usize) -> Result<SteppedFmu> {
        let number = self.first + place;
        let mut planned = self.planned.clone();
        planned.name = self.setup.name(&planned.name, number);
        let mut fmu =
            SteppedFmu::instantiate(planned, number, self.setup.fmu.start, self.messages.clone())?;
        if let Some(cycle) = &self.cycle {
            fmu.prepare(cycle);
        }
        Ok(fmu)
    }

    fn step(&mut self, place: usize) -> Result<()> {
        let Some(fmu) = &mut self.instances[place] else { return Ok(()) };
        if !self.exchange.action(place, &mut self.action) {
            return Ok(());
        }
        let VectorSetup { actions, step, .. } = &self.setup;
        match &self.cycle {
            Some(cycle) => fmu.perform(cycle, &self.action, *step, &mut self.observation)?,
            None => {
                let values = actions.iter().zip(&self.action);
                let values = values.map(|(s, n)| Ok((*s, typed(&self.planned, *s, *n)?)));
                fmu.fulfil(&Request::Set(values.collect::<Result<_>>()?))?;
                fmu.fulfil(&Request::Step(*step))?;
                get(fmu, &self.setup, &mut self.observation)?;
            }
        }
        self.exchange.set_observation(place, &self.observation);
        Ok(())
    }
}

fn get(fmu: &mut SteppedFmu, setup: &VectorSetup, observation: &mut [f64]) -> Result<()> {
    if let Response::Values(values) = fmu.fulfil(&Request::Get(setup.observations.clone()))? {
        observation.iter_mut().zip(&values).for_each(|(to, value)| *to = number(value));
    }
    Ok(())
}

/// Does the tasks of the supervisor of this worker process, until there are no more.
///
/// # Errors
/// A task is damaged, or the memory.
pub fn serve(service: &mut Service, source: &ShareSource) -> Result<()> {
    let record = service.record().clone();
    let ShareSource { vector, numbers, .. } = source;
    let names = match Names::open(&vector.fmu) {
        Ok(names) => names,
        Err(error) => {
            service.reply(&Outcome::Err(RunError::new(error, Vec::new())));
            return Ok(());
        }
    };
    let exchange = Exchange::open(source)?;
    let mut share = Share::new(&names, vector, numbers.clone(), exchange, record.clone());
    while let Some(task) = service.task()? {
        let outcome = share.fulfil(&task);
        record.end_call();
        service.reply(&outcome);
    }
    Ok(())
}
