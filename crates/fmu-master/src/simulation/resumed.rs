//! Takes the state of a run for a file, and begins a run from such a state.

use anyhow::{Result, ensure};
use fmu_description::{Causality, Value, Variability};

use super::Simulation;
use crate::component_instance::CallResult;
use crate::saved_run::{SavedComponent, SavedRun, SystemIdentity};
use crate::start::ComponentStarts;
use crate::{Experiment, Plan};

/// The start values of a component that differ from the ones with which the saved run began.
pub(super) type Changes = Vec<(usize, Value)>;

impl Plan {
    /// The first communication point of a run.
    pub fn first(&self) -> u64 {
        self.loaded.as_ref().map_or(0, |loaded| loaded.k)
    }

    /// The time (s) at which parameters of a component from a table were set last before communication point `k`, where it
    /// steps: at the start, or before its last step.
    pub(crate) fn last_setting(&self, component: usize, k: u64) -> f64 {
        let (rate, start) = (self.components[component].rate, self.experiment.start);
        let before = k.checked_sub(rate.every).and_then(|k| rate.times(k, start).last());
        before.unwrap_or(start)
    }

    /// The times of the rows of a run (s): it starts at the time of the saved state, if it begins from one.
    pub fn times(&self) -> Experiment {
        Experiment { start: self.experiment.time(self.first()), ..self.experiment }
    }

    /// What a run with these start values changes of the saved state from which it begins.
    ///
    /// # Errors
    /// Something that cannot be changed during a run.
    pub(super) fn changes(&self, starts: &[ComponentStarts<'_>]) -> Result<Vec<Changes>> {
        let loaded = self.loaded.iter().flat_map(|loaded| &loaded.components);
        let all = loaded.zip(&*self.components).zip(starts);
        let changes = all.map(|((saved, component), starts)| {
            let fmu = &component.fmu;
            let earlier = saved.starts.keys().filter_map(|name| fmu.get_scalar(name));
            let mut scalars = Vec::from_iter(starts.scalars().chain(earlier));
            scalars.sort_unstable();
            scalars.dedup();
            let mut changes = Vec::new();
            for scalar in scalars {
                let was = saved.starts.get(&fmu.name(scalar)).or(fmu.start(scalar));
                let is = starts.get(scalar).or(fmu.start(scalar));
                if was == is {
                    continue;
                }
                let shown = |value: Option<&Value>| {
                    value.map_or_else(|| "no start value".to_owned(), Value::to_string)
                };
                let variable = fmu.variable(scalar);
                let is_settable = variable.causality == Causality::Input
                    || variable.variability == Variability::Tunable;
                let changed = is.filter(|_| is_settable);
                ensure!(
                    changed.is_some(),
                    "{} = {}: the saved run began with {}, and only inputs and tunable parameters can differ",
                    component.name_of(scalar),
                    shown(is),
                    shown(was)
                );
                changes.extend(changed.map(|value| (scalar, value.clone())));
            }
            Ok(changes)
        });
        changes.collect()
    }
}

impl Simulation<'_> {
    /// The state at a communication point, before its step.
    pub(super) fn state(&mut self, k: u64, system: &SystemIdentity) -> CallResult<SavedRun> {
        let components = self.components.iter_mut().zip(&self.starts).enumerate();
        let components = components.map(|(index, (component, starts))| {
            let state = component.serialize()?;
            let integrator = component.integrator.as_ref().map(|integrator| integrator.state());
            let event_mode = component.event_mode.as_deref().cloned();
            let mut starts = starts.clone();
            if let (Some(table), None) = (&self.plan.input, &self.plan.live) {
                let last = self.plan.last_setting(index, k);
                let set = table.parameters_at(index, last);
                starts
                    .extend(set.map(|(scalar, value)| (component.fmu.name(scalar), value.clone())));
            }
            Ok(SavedComponent { state, integrator, event_mode, starts })
        });
        let components = components.collect::<CallResult<_>>()?;
        let faults = self.faulty_connections.iter().flatten().flat_map(|c| &c.faults);
        Ok(SavedRun {
            system: system.clone(),
            start: self.plan.experiment.start,
            k,
            components,
            faults: faults.map(|fault| fault.memory.clone()).collect(),
        })
    }

    /// Goes on from a saved state, after the initialization, with the start values that were changed.
    pub(super) fn resume(&mut self, saved: &SavedRun, changes: &[Changes]) -> CallResult {
        let time = self.plan.experiment.time(saved.k);
        self.messages.record().at(time);
        let components = self.components.iter_mut().zip(&saved.components);
        for ((component, saved), changes) in components.zip(changes) {
            component.deserialize(saved).map_err(|failure| failure.at(time))?;
            let starts = ComponentStarts::new(changes.iter());
            let changed = component.change_starts(&starts, time);
            changed.map_err(|failure| failure.at(time))?;
        }
        let faults = self.faulty_connections.iter_mut().flatten().flat_map(|c| &mut c.faults);
        for (fault, memory) in faults.zip(&saved.faults) {
            // Equal systems have delays of equal length.
            if fault.memory.len() == memory.len() {
                fault.memory.copy_from_slice(memory);
            }
        }
        Ok(())
    }
}
