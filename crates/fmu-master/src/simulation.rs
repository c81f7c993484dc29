//! One run of a system.

mod adaptive;
mod advance;
mod clocked;
mod extrapolated;
mod hosted;
mod internal_steps;
mod iteration;
mod paced;
mod resumed;
mod row;
mod saved;
mod threads;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::thread;

use anyhow::{Result, bail};
use fmu_description::Value;
use fmu_host::Instance;

pub use row::Row;
pub use saved::Snapshot;

use crate::component_instance::{CallResult, ComponentInstance, get_feeding_outputs};
use crate::components::{LoadedComponent, ScalarId};
use crate::crew::Crew;
use crate::fault::FaultyConnection;
use crate::iterated_group::Stage;
use crate::pace::{Pace, Punctuality};
use crate::saved_run::SavedRun;
use crate::start::ComponentStarts;
use crate::step_control::AdaptiveSteps;
use crate::store::Store;
use crate::table_inputs::TableInputs;
use crate::table_parameters::TableParameters;
use crate::{Message, Messages, Order, Plan, RunError, StartValue};

/// An initialized run of a system.
pub struct Simulation<'a> {
    plan: &'a Plan,
    components: Vec<ComponentInstance<'a>>,
    /// The outputs of all components that were read last.
    outputs: Store,
    row: Row,
    /// The connections with faults that lead to each component.
    faulty_connections: Vec<Vec<FaultyConnection>>,
    /// The snapshots that were made, by their numbers.
    saved: Vec<saved::Saved<'a>>,
    /// The start values of each component by name, if the state is to be saved, and the saved state.
    starts: Vec<BTreeMap<String, Value>>,
    state: Option<SavedRun>,
    /// What is kept for adaptive steps, and whether one is taken, in which faults do not act again.
    adaptive: Option<Box<adaptive::Adaptive>>,
    is_within_step: bool,
    /// The iterated groups.
    iterations: Vec<iteration::Iteration>,
    /// The states to which components with clocks return, if they have stepped too far.
    returns: Vec<Option<Snapshot>>,
    messages: Messages,
    /// Its pace, if it is paced by the clock.
    pace: Option<Box<Pace>>,
    /// The threads in which its components step at the same time.
    crew: Option<Arc<Crew<'a>>>,
    /// Why it has ended in the first event, if an FMU has ended it there.
    ended: Option<Box<RunError>>,
}

/// A run that has reached its end, besides its rows.
#[derive(Debug)]
pub struct Finished {
    /// The messages of the FMUs.
    pub messages: Vec<Message>,
    /// The last row.
    pub last: Row,
    /// Who has ended the simulation before the stop time, if an FMU has.
    pub ended: Option<RunError>,
    /// How well it has kept the time, if it was paced by the clock.
    pub punctuality: Option<Punctuality>,
    /// Its adaptive steps, if it has taken such.
    pub adaptive_steps: Option<AdaptiveSteps>,
    /// The state at the stop time, if it was to be saved.
    pub(crate) state: Option<SavedRun>,
}

impl Plan {
    /// Creates and initializes the instances of a run, which log to `messages`; `starts` override the start
    /// values of the description.
    ///
    /// # Errors
    /// An FMU returns an error; its message is included.
    pub fn simulate(&self, starts: &[StartValue], messages: &Messages) -> Result<Simulation<'_>> {
        let starts = self.all_starts(starts)?;
        let changes = self.changes(&starts)?;
        let mut simulation = self.instantiate(&starts, messages)?;
        let begun = simulation.initialize(&starts).and_then(|()| match &self.loaded {
            Some(loaded) => simulation.resume(loaded, &changes),
            None => Ok(()),
        });
        simulation.ended = match begun {
            Err(failure) if failure.ended.is_none() => bail!(*failure),
            initialized => initialized.err(),
        };
        Ok(simulation)
    }

    /// The start values of all components in a run.
    pub(crate) fn all_starts<'a>(
        &'a self,
        replaced: &'a [StartValue],
    ) -> Result<Vec<ComponentStarts<'a>>> {
        (0..self.components.len()).map(|index| self.starts(index, replaced)).collect()
    }

    /// Creates the instances of a run.
    pub(crate) fn instantiate(
        &self,
        starts: &[ComponentStarts<'_>],
        messages: &Messages,
    ) -> Result<Simulation<'_>> {
        messages.record().at(f64::NAN);
        messages.record().step(self.experiment.step);
        let named = |(component, starts): (&LoadedComponent, &ComponentStarts<'_>)| {
            let value = |scalar| Some((component.fmu.name(scalar), starts.get(scalar)?.clone()));
            starts.scalars().filter_map(value).collect()
        };
        let saved = self.components.iter().zip(starts).filter(|_| self.save.is_some());
        let groups = self.components.iter().zip(&self.wiring.groups);
        let components =
            groups.zip(starts).enumerate().map(|(index, ((component, groups), starts))| {
                ComponentInstance::new(index, component, groups, starts, messages)
            });
        let mut simulation = Simulation {
            plan: self,
            components: components.collect::<Result<_>>()?,
            outputs: Store::new(self.wiring.counts),
            row: Row::new(&self.columns),
            faulty_connections: self.wiring.faulty_connections.clone(),
            saved: Vec::new(),
            starts: saved.map(named).collect(),
            state: None,
            adaptive: None,
            is_within_step: false,
            iterations: Vec::new(),
            returns: Vec::new(),
            messages: messages.clone(),
            pace: None,
            crew: None,
            ended: None,
        };
        simulation.prepare_iterations()?;
        simulation.prepare_returns()?;
        simulation.prepare_adaptive_steps()?;
        Ok(simulation)
    }
}

impl Simulation<'_> {
    /// Initializes with the calls of FMPy, in its order.
    fn initialize(&mut self, starts: &[ComponentStarts<'_>]) -> CallResult {
        // A run that is saved may be continued for any time.
        self.enter_initialization(starts, self.plan.save.is_none())?;
        self.exit_initialization(starts)
    }

    /// Sets up the components, with the stop time of the experiment if it `has_stop`, and passes initial outputs to
    /// inputs.
    fn enter_initialization(
        &mut self,
        starts: &[ComponentStarts<'_>],
        has_stop: bool,
    ) -> CallResult {
        let (plan, start) = (self.plan, self.plan.experiment.start);
        self.messages.record().at(start);
        self.begin_inputs(starts);
        self.begin_clocked(starts);
        self.feed(start)?;
        for (index, component) in self.components.iter_mut().enumerate() {
            let tolerance = plan.components[index].tolerance;
            let stop = has_stop.then(|| plan.end_of(index));
            component.set_up((start, stop), tolerance, &starts[index])?;
        }
        let entered =
            self.components.iter_mut().try_for_each(ComponentInstance::enter_initialization);
        let propagated = entered.and_then(|()| self.propagate());
        propagated.map_err(|failure| failure.at(start))
    }

    fn exit_initialization(&mut self, starts: &[ComponentStarts<'_>]) -> CallResult {
        let (plan, start) = (self.plan, self.plan.experiment.start);
        for member in plan.schedule.clocked.iter().flat_map(|stage| &stage.members) {
            let begun = self.components[member.component].begin_clocks(&member.inputs, start);
            begun.map_err(|failure| failure.at(start))?;
            if member.is_scheduled {
                self.components[member.component].begin_activations(member);
            }
        }
        let exited =
            self.components.iter_mut().try_for_each(ComponentInstance::exit_initialization);
        let begun = exited.and_then(|()| {
            let components = self.components.iter_mut().zip(&*plan.components);
            components.enumerate().try_for_each(|(index, (component, loaded))| {
                let (fmu, groups, starts) =
                    (&loaded.fmu, &plan.wiring.groups[index], &starts[index]);
                // Values that arrive are held, as those from other components are.
                let table = plan.input.as_ref().filter(|_| plan.live.is_none());
                let last = plan.last_setting(index, plan.first());
                component.parameters =
                    table.and_then(|t| TableParameters::new(t, index, fmu, starts, last));
                let inputs = table.and_then(|t| TableInputs::new(t, index, fmu, groups, starts));
                component.begin(inputs, loaded, (start, loaded.rate.step))
            })
        });
        begun.map_err(|failure| failure.at(start))
    }

    fn call_all(
        &mut self,
        operation: &str,
        what: &str,
        call: impl Fn(&mut Instance) -> fmu_host::Result,
    ) -> CallResult {
        let mut components = self.components.iter_mut();
        components.try_for_each(|component| component.call(operation, what, &call))
    }

    /// Propagates initial outputs to inputs, once per component, since outputs may depend on inputs. Does not set inputs
    /// again to the same values, as an FMU may then compute its outputs again.
    fn propagate(&mut self) -> CallResult {
        let plan = self.plan;
        let clocked = plan.schedule.clocked.iter().flat_map(|stage| &stage.members);
        let clocked = Vec::from_iter(clocked.map(|member| member.component));
        let mut last = vec![None; self.components.len()];
        for _ in 0..=self.components.len() {
            let mut changed = false;
            for stage in &plan.schedule.stages {
                let fed = match stage {
                    Stage::Component(index) => std::slice::from_ref(index),
                    Stage::Group(number) => &*plan.schedule.groups[*number].components,
                    Stage::Clocked => &*clocked,
                };
                let values = Some(self.get_feeding(fed)?);
                if last[fed[0]] == values {
                    continue;
                }
                last[fed[0]] = match *stage {
                    Stage::Component(index) => {
                        self.components[index].write_initially(&self.outputs)?;
                        values
                    }
                    Stage::Clocked => {
                        for index in &clocked {
                            self.components[*index].write_initially(&self.outputs)?;
                        }
                        values
                    }
                    Stage::Group(number) => {
                        self.iterate_initially(number)?;
                        Some(self.get_feeding(fed)?)
                    }
                };
                changed = true;
            }
            if !changed {
                break;
            }
        }
        Ok(())
    }

    /// Gets the outputs that feed components.
    fn get_feeding(&mut self, components: &[usize]) -> CallResult<Vec<Value>> {
        let mut all = Vec::new();
        for index in components {
            let feeding = &self.plan.wiring.feeding[*index];
            all.extend(get_feeding_outputs(&mut self.components, feeding, &mut self.outputs)?);
        }
        Ok(all)
    }

    /// Steps from the start to the stop time, or until `observe`, which receives the row of each
    /// communication point, returns false, or until an FMU ends the simulation.
    ///
    /// # Errors
    /// A [`RunError`]: a call of an FMU failed, which ends the run.
    pub fn run(mut self, observe: impl FnMut(&Row) -> bool) -> Result<Finished> {
        self.begin_pace();
        let Some(crew) = Crew::new(self.plan, self.messages.record()) else {
            return self.run_to_end(observe);
        };
        self.crew = Some(crew.clone());
        thread::scope(|scope| {
            let _over = crew.start(scope);
            self.run_to_end(observe)
        })
    }

    fn run_to_end(mut self, mut observe: impl FnMut(&Row) -> bool) -> Result<Finished> {
        let is_plain = self.is_plain();
        let steps = match (self.ended.take(), is_plain) {
            (Some(failure), _) => self.record_start(&mut observe).and(Err(failure)),
            (None, true) => self.steps::<true>(&mut observe),
            (None, false) => self.steps::<false>(&mut observe),
        };
        let ended = match steps {
            Ok(()) => None,
            Err(failure) if failure.ended.is_some() => {
                self.end_early(&failure, observe).map_err(|failure| *failure)?;
                Some(*failure)
            }
            Err(failure) => return Err(anyhow::Error::new(*failure)),
        };
        let (messages, last) = (self.messages.take(), std::mem::take(&mut self.row));
        let (punctuality, state) = (self.punctuality(), self.state.take());
        let adaptive_steps = self.adaptive_steps();
        Ok(Finished { messages, last, ended, punctuality, adaptive_steps, state })
    }

    /// Whether it steps in the fastest way.
    fn is_plain(&self) -> bool {
        let Plan { wiring, components, save, .. } = self.plan;
        wiring.is_plain
            && self.pace.is_none()
            && self.crew.is_none()
            && save.is_none()
            && self.iterations.is_empty()
            && self.adaptive.is_none()
            && components.iter().all(LoadedComponent::is_plain)
    }

    /// Reads the outputs of all components, but not between the initialization of one and its first tick, which computes
    /// them.
    fn read_all<const PLAIN: bool>(&mut self) -> CallResult {
        let mut components = self.components.iter_mut().filter(|c| PLAIN || !c.is_in_event_mode());
        components.try_for_each(|component| component.read::<PLAIN>(&mut self.outputs))
    }

    /// Takes the values before the first step.
    fn record_start(&mut self, observe: &mut impl FnMut(&Row) -> bool) -> CallResult {
        self.row.time = self.plan.times().start;
        self.read_all::<false>()?;
        self.row.store.record::<false>(&self.plan.wiring.recorded_before, &self.outputs);
        if !self.plan.steps_from_stop() {
            observe(&self.row);
        }
        Ok(())
    }

    /// Ends a run after a step or the first event in which an FMU has ended the simulation. If the row of the
    /// communication point waits for sampled components, it is complete if none of them had yet to step. A single FMU
    /// has one more row, at the time that it has reached.
    fn end_early(&mut self, end: &RunError, mut observe: impl FnMut(&Row) -> bool) -> CallResult {
        let wiring = &self.plan.wiring;
        let component = end.call.as_ref().map(|call| &call.component);
        let mut all = self.plan.components.iter().skip_while(|c| Some(&c.name) != component);
        if self.plan.steps_from_stop() && all.all(|component| !component.sampled) {
            self.row.store.record::<false>(&wiring.recorded_after, &self.outputs);
            observe(&self.row);
        }
        if let ([component], Some(reached)) = (&mut *self.components, end.ended)
            && reached > self.row.time
            && component.read::<false>(&mut self.outputs).is_ok()
        {
            self.row.time = reached;
            self.row.store.record::<false>(&wiring.recorded_before, &self.outputs);
            self.row.store.record::<false>(&wiring.recorded_after, &self.outputs);
            observe(&self.row);
        }
        self.call_all("terminate", "end", Instance::terminate)
    }

    #[inline(always)]
    fn steps<const PLAIN: bool>(&mut self, observe: &mut impl FnMut(&Row) -> bool) -> CallResult {
        let (experiment, wiring) = (&self.plan.experiment, &self.plan.wiring);
        // Checked when the plan was made.
        let points = experiment.steps().unwrap_or(0);
        // Without sampled components, a row is complete before the step.
        let is_late = self.plan.steps_from_stop() || self.plan.schedule.clocked.is_some();
        let steps = self.plan.communication_steps();
        let failed_at = |time| move |failure: Box<RunError>| failure.at(time);
        // Later, the outputs of a component are read after each of its steps.
        let start = self.plan.times().start;
        self.read_all::<PLAIN>().map_err(failed_at(start))?;
        if !PLAIN {
            let mut all = 0..self.components.len();
            let read = all.try_for_each(|index| self.read_derivatives(index, start));
            read.map_err(failed_at(start))?;
        }
        // The first step reads them at the same communication point, but in other calls.
        self.components.iter_mut().for_each(|component| component.recorded.calls.begin(None));
        if !PLAIN {
            self.begin_internal_steps();
        }
        for k in self.plan.first()..points {
            let time = experiment.time(k);
            self.messages.record().at(time);
            if !PLAIN {
                self.wait(time);
                self.feed(time).map_err(failed_at(time))?;
            }
            self.row.time = time;
            self.row.store.record::<PLAIN>(&wiring.recorded_before, &self.outputs);
            if !is_late && !observe(&self.row) {
                break;
            }
            if let (false, Some((_, system))) = (PLAIN, &self.plan.save)
                && k + 1 == points
            {
                let state = self.state(k, system).map_err(failed_at(time))?;
                self.state = Some(state);
            }
            if k < steps {
                let stepped = match PLAIN {
                    true => self.step_plainly(time, experiment.step),
                    false => self.advance_paced(k, time, experiment.step),
                };
                stepped.map_err(failed_at(time))?;
                if !PLAIN
                    && self.plan.records_internal_steps
                    && !self.observe_internal_steps(observe)
                {
                    break;
                }
                self.row.store.record::<PLAIN>(&wiring.recorded_after, &self.outputs);
            } else if !PLAIN && self.plan.schedule.clocked.is_some() {
                self.hold();
                self.tick_at_point(k, time, experiment.step).map_err(failed_at(time))?;
            }
            if is_late && !observe(&self.row) {
                break;
            }
        }
        self.call_all("terminate", "end", Instance::terminate)
    }

    /// Takes the start values of inputs whose rows arrive while the run goes.
    fn begin_inputs(&mut self, starts: &[ComponentStarts<'_>]) {
        let Plan { components, input, wiring, live, .. } = self.plan;
        let inputs = input.iter().filter(|_| live.is_some()).flat_map(|table| &table.inputs);
        for (column, place) in inputs.zip(&wiring.table_places) {
            let ScalarId { component, scalar } = column.to;
            let start = starts[component].value(scalar, &components[component].fmu);
            self.outputs.set(*place, start);
        }
    }

    /// Takes the values of a time from the input table, or those that have arrived.
    fn feed(&mut self, time: f64) -> CallResult {
        let Plan { input, wiring, live, .. } = self.plan;
        let places = &wiring.table_places;
        match (live, input) {
            (Some(live), _) => {
                let applied = live.apply(time, places, &mut self.outputs);
                applied.map_err(|error| RunError::new(error, Vec::new()))?;
            }
            (None, Some(input)) => input.apply(time, places, &mut self.outputs),
            (None, None) => {}
        }
        Ok(())
    }

    /// Steps a plain system from one communication point to the next.
    #[inline]
    fn step_plainly(&mut self, time: f64, step: f64) -> CallResult {
        let (components, outputs) = (&mut self.components, &mut self.outputs);
        if self.plan.order != Order::Parallel {
            for component in components.iter_mut() {
                component.cycle(outputs, time, step)?;
            }
            return Ok(());
        }
        for component in components.iter_mut() {
            component.write::<true>(outputs)?;
        }
        for component in components {
            component.step::<true>(time, step)?;
            component.read::<true>(outputs)?;
        }
        Ok(())
    }
}

impl Drop for Simulation<'_> {
    /// Frees snapshots and instances, and records that no call is in progress.
    fn drop(&mut self) {
        self.forget_all();
        self.components.clear();
        self.messages.record().end_call();
    }
}
