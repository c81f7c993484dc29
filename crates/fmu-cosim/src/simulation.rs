//! One run of a system.

use std::collections::BTreeMap;

use anyhow::Result;

use crate::instance::{Called, Instance};
use crate::transfer::{self, Component, Values, propagate};
use crate::{Failure, Message, Messages, Order, Plan, Start};

/// An initialized run of a system.
pub struct Simulation<'a> {
    plan: &'a Plan,
    components: Vec<Component<'a>>,
    /// The outputs of all components that were read last.
    outputs: Values,
    row: Vec<f64>,
    messages: Messages,
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
        let components = plan
            .components
            .iter()
            .zip(&plan.wiring.components)
            .enumerate()
            .map(|(index, (c, ports))| {
                let starts = plan.starts(index, starts);
                plan.check_arrays(index, &starts)?;
                let instance = Instance::new(index, &c.name, &c.fmu, messages)?;
                Ok(Component::new(instance, ports, &starts))
            });
        let mut simulation = Self {
            plan,
            components: components.collect::<Result<_>>()?,
            outputs: Values::zeros(&plan.wiring.outputs),
            row: vec![0.0; plan.columns().len()],
            messages: messages.clone(),
        };
        simulation.initialize(starts).map_err(|failure| *failure)?;
        Ok(simulation)
    }

    /// Initializes with the calls of FMPy, in its order.
    fn initialize(&mut self, starts: &[Start]) -> Called {
        let plan = self.plan;
        let (start, end) = (plan.experiment.start, plan.end());
        self.messages.recorder().at(start);
        for (index, component) in self.components.iter_mut().enumerate() {
            let instance = &mut component.instance;
            instance.set_up(start, end, plan.components[index].tolerance)?;
            let fmu = instance.fmu().clone();
            let (sizes, starts): (BTreeMap<_, _>, _) = (plan.starts(index, starts).into_iter())
                .partition(|(index, _)| fmu.variables[*index].is_structural);
            if !sizes.is_empty() {
                instance.enter_configuration()?;
                transfer::start(instance, &sizes)?;
                instance.exit_configuration()?;
            }
            transfer::start(instance, &starts)?;
        }
        self.initialize_all().map_err(|failure| failure.at(start))
    }

    fn initialize_all(&mut self) -> Called {
        self.call_all(Instance::enter_initialization)?;
        self.propagate()?;
        self.call_all(Instance::exit_initialization)
    }

    fn call_all(&mut self, call: impl Fn(&mut Instance) -> Called) -> Called {
        let components = self.components.iter_mut();
        let mut instances = components.map(|component| &mut component.instance);
        instances.try_for_each(call)
    }

    /// Propagates initial outputs to inputs, once per component, since outputs may depend on inputs.
    fn propagate(&mut self) -> Called {
        for _ in 0..=self.components.len() {
            let mut changed = false;
            for fed in 0..self.components.len() {
                changed |= propagate(&mut self.components, fed, &mut self.outputs)?;
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
        let Plan {
            experiment, wiring, ..
        } = self.plan;
        let others = wiring.records_others;
        // Checked when the plan was made.
        let steps = experiment.steps().unwrap_or(0);
        let last = match self.plan.steps_from_stop() {
            true => steps,
            false => steps.saturating_sub(1),
        };
        let failed_at = |time| move |failure: Box<Failure>| failure.at(time);
        self.read_all().map_err(failed_at(experiment.start))?;
        for k in 0..steps {
            let time = experiment.time(k);
            self.messages.recorder().at(time);
            self.outputs.record(&wiring.before, others, &mut self.row);
            if k < last {
                self.step(time, experiment.step).map_err(failed_at(time))?;
                self.outputs.record(&wiring.after, others, &mut self.row);
            }
            if !observe(time, &self.row) {
                break;
            }
        }
        self.call_all(Instance::terminate)
    }

    /// Reads all outputs; later, those of a component are read after each of its steps.
    fn read_all(&mut self) -> Called {
        let mut components = self.components.iter_mut();
        components.try_for_each(|component| component.read(&mut self.outputs))
    }

    /// Steps from one communication point to the next.
    #[inline]
    fn step(&mut self, time: f64, step: f64) -> Called {
        let (components, outputs) = (&mut self.components, &mut self.outputs);
        match self.plan.order {
            Order::Sequential => components.iter_mut().try_for_each(|component| {
                component.write(outputs)?;
                component.instance.step(time, step)?;
                component.read(outputs)
            }),
            Order::Parallel => {
                let mut all = components.iter_mut();
                all.try_for_each(|component| component.write(outputs))?;
                components.iter_mut().try_for_each(|component| {
                    component.instance.step(time, step)?;
                    component.read(outputs)
                })
            }
        }
    }
}

impl Drop for Simulation<'_> {
    /// Frees the instances, and records that no call is in progress.
    fn drop(&mut self) {
        self.components.clear();
        self.messages.recorder().end_call();
    }
}
