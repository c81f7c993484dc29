//! One run of a system.

use anyhow::Result;
use fmu_description::VariableType;

use crate::instance::{Called, Instance};
use crate::transfer::{Boolean, Integer, Reader, Real, Transfer, Type};
use crate::wiring::{Record, Wire};
use crate::{Failure, Message, Messages, Order, Plan, Start};

/// An initialized run of a system.
pub struct Simulation<'a> {
    plan: &'a Plan,
    instances: Vec<Instance>,
    /// The connections to each component.
    inputs: Vec<Inputs>,
    /// Continuous components, which are read before a step.
    before: Readers,
    /// Sampled components, which are read after a step.
    after: Readers,
    row: Vec<f64>,
    messages: Messages,
}

#[derive(Default)]
struct Inputs {
    reals: Vec<Transfer<Real>>,
    integers: Vec<Transfer<Integer>>,
    booleans: Vec<Transfer<Boolean>>,
}

#[derive(Default)]
struct Readers {
    reals: Vec<Reader<Real>>,
    integers: Vec<Reader<Integer>>,
    booleans: Vec<Reader<Boolean>>,
}

impl Inputs {
    fn new(wires: &[Wire]) -> Self {
        fn transfer<T: Type>(wire: &Wire) -> Transfer<T> {
            Transfer::new(
                wire.outputs.clone(),
                wire.inputs.clone(),
                wire.scales.clone(),
            )
        }
        let mut inputs = Self::default();
        for wire in wires {
            match wire.kind {
                VariableType::Real => inputs.reals.push(transfer(wire)),
                VariableType::Boolean => inputs.booleans.push(transfer(wire)),
                _ => inputs.integers.push(transfer(wire)),
            }
        }
        inputs
    }

    #[inline]
    fn fetch(&mut self, instances: &mut [Instance]) -> Called {
        self.reals.iter_mut().try_for_each(|t| t.fetch(instances))?;
        self.integers
            .iter_mut()
            .try_for_each(|t| t.fetch(instances))?;
        self.booleans
            .iter_mut()
            .try_for_each(|t| t.fetch(instances))
    }

    #[inline]
    fn deliver(&self, instances: &mut [Instance]) -> Called {
        self.reals.iter().try_for_each(|t| t.deliver(instances))?;
        self.integers
            .iter()
            .try_for_each(|t| t.deliver(instances))?;
        self.booleans.iter().try_for_each(|t| t.deliver(instances))
    }

    /// Fetches inputs; returns whether a value has changed.
    fn fetch_changes(&mut self, instances: &mut [Instance]) -> Result<bool, Box<Failure>> {
        let mut changed = false;
        for transfer in &mut self.reals {
            changed |= transfer.fetch_changes(instances)?;
        }
        for transfer in &mut self.integers {
            changed |= transfer.fetch_changes(instances)?;
        }
        for transfer in &mut self.booleans {
            changed |= transfer.fetch_changes(instances)?;
        }
        Ok(changed)
    }
}

impl Readers {
    fn push(&mut self, record: &Record) {
        let (group, columns) = (record.group.clone(), record.columns.clone());
        match record.kind {
            VariableType::Real => self.reals.push(Reader::new(group, columns)),
            VariableType::Boolean => self.booleans.push(Reader::new(group, columns)),
            _ => self.integers.push(Reader::new(group, columns)),
        }
    }

    #[inline]
    fn read(&mut self, instances: &mut [Instance], row: &mut [f64]) -> Called {
        self.reals
            .iter_mut()
            .try_for_each(|r| r.read(instances, row))?;
        self.integers
            .iter_mut()
            .try_for_each(|r| r.read(instances, row))?;
        self.booleans
            .iter_mut()
            .try_for_each(|r| r.read(instances, row))
    }
}

impl Plan {
    /// Creates and initializes the instances of a run; `starts` override the start values of the
    /// description.
    ///
    /// # Errors
    /// An FMU returns an error; its message is included.
    pub fn simulate(&self, starts: &[Start]) -> Result<Simulation<'_>> {
        self.simulate_with(starts, &Messages::default())
    }

    /// Like [`Plan::simulate`], but the messages of the FMUs are available even if it or the run fails.
    ///
    /// # Errors
    /// See [`Plan::simulate`].
    pub fn simulate_with(&self, starts: &[Start], messages: &Messages) -> Result<Simulation<'_>> {
        Simulation::new(self, starts, messages)
    }
}

impl<'a> Simulation<'a> {
    fn new(plan: &'a Plan, starts: &[Start], messages: &Messages) -> Result<Self> {
        messages.recorder().at(f64::NAN);
        messages.recorder().step(plan.experiment.step);
        let (mut before, mut after) = (Readers::default(), Readers::default());
        for record in &plan.records {
            let sampled = plan.components[record.group.component].sampled;
            if sampled { &mut after } else { &mut before }.push(record);
        }
        let instances = plan
            .components
            .iter()
            .enumerate()
            .map(|(index, c)| Instance::new(index, &c.name, &c.fmu, messages));
        let mut simulation = Self {
            plan,
            instances: instances.collect::<Result<_>>()?,
            inputs: plan.wires.iter().map(|wires| Inputs::new(wires)).collect(),
            before,
            after,
            row: vec![0.0; plan.columns().len()],
            messages: messages.clone(),
        };
        simulation.initialize(starts).map_err(|failure| *failure)?;
        Ok(simulation)
    }

    /// Initializes with the calls of FMPy, in its order.
    fn initialize(&mut self, starts: &[Start]) -> Called {
        let (start, end) = (self.plan.experiment.start, self.plan.end());
        self.messages.recorder().at(start);
        for (index, instance) in self.instances.iter_mut().enumerate() {
            instance.set_up(start, end, self.plan.components[index].tolerance)?;
            for (variable, value) in self.plan.starts(index, starts) {
                instance.set(variable, value)?;
            }
        }
        self.initialize_all().map_err(|failure| failure.at(start))
    }

    fn initialize_all(&mut self) -> Called {
        self.instances
            .iter_mut()
            .try_for_each(Instance::enter_initialization)?;
        self.propagate()?;
        self.instances
            .iter_mut()
            .try_for_each(Instance::exit_initialization)
    }

    /// Propagates initial outputs to inputs, once per component, since outputs may depend on inputs.
    fn propagate(&mut self) -> Called {
        for _ in 0..=self.inputs.len() {
            let mut changed = false;
            for inputs in &mut self.inputs {
                changed |= inputs.fetch_changes(&mut self.instances)?;
                inputs.deliver(&mut self.instances)?;
            }
            if !changed {
                break;
            }
        }
        Ok(())
    }

    /// Steps from the start to the stop time; `observe` receives the time (s) and the row of each
    /// communication point. Returns the messages of the FMUs.
    ///
    /// # Errors
    /// A [`Failure`]: a call of an FMU failed, which ends the run.
    pub fn run(self, mut observe: impl FnMut(f64, &[f64])) -> Result<Vec<Message>> {
        self.run_while(|time, row| {
            observe(time, row);
            true
        })
    }

    /// Like [`Simulation::run`], but stops early when `observe` returns false.
    ///
    /// # Errors
    /// See [`Simulation::run`].
    pub fn run_while(mut self, observe: impl FnMut(f64, &[f64]) -> bool) -> Result<Vec<Message>> {
        self.steps(observe).map_err(|failure| *failure)?;
        Ok(self.messages.take())
    }

    fn steps(&mut self, mut observe: impl FnMut(f64, &[f64]) -> bool) -> Called {
        let experiment = self.plan.experiment;
        // Checked when the plan was made.
        let steps = experiment.steps().unwrap_or(0);
        let last = match self.plan.steps_from_stop() {
            true => steps,
            false => steps.saturating_sub(1),
        };
        for k in 0..steps {
            let time = experiment.time(k);
            self.messages.recorder().at(time);
            let row = match k < last {
                true => self.step(time, experiment.step),
                false => self.before.read(&mut self.instances, &mut self.row),
            };
            row.map_err(|failure| failure.at(time))?;
            if !observe(time, &self.row) {
                break;
            }
        }
        self.instances.iter_mut().try_for_each(Instance::terminate)
    }

    /// Steps from one communication point to the next and fills the row.
    #[inline]
    fn step(&mut self, time: f64, step: f64) -> Called {
        self.before.read(&mut self.instances, &mut self.row)?;
        match self.plan.order {
            Order::Sequential => self.step_sequentially(time, step)?,
            Order::Parallel => self.step_in_parallel(time, step)?,
        }
        self.after.read(&mut self.instances, &mut self.row)
    }

    #[inline]
    fn step_sequentially(&mut self, time: f64, step: f64) -> Called {
        for (index, inputs) in self.inputs.iter_mut().enumerate() {
            inputs.fetch(&mut self.instances)?;
            inputs.deliver(&mut self.instances)?;
            self.instances[index].step(time, step)?;
        }
        Ok(())
    }

    #[inline]
    fn step_in_parallel(&mut self, time: f64, step: f64) -> Called {
        for inputs in &mut self.inputs {
            inputs.fetch(&mut self.instances)?;
        }
        for inputs in &self.inputs {
            inputs.deliver(&mut self.instances)?;
        }
        self.instances
            .iter_mut()
            .try_for_each(|instance| instance.step(time, step))
    }
}

impl Drop for Simulation<'_> {
    /// Frees the instances, and records that no call is in progress.
    fn drop(&mut self) {
        self.instances.clear();
        self.messages.recorder().end_call();
    }
}
