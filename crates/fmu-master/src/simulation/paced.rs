//! A run that is paced by the clock.

use fmu_host::real_time;

use super::Simulation;
use crate::component_instance::{CallResult, ComponentInstance};
use crate::pace::{Pace, Punctuality};

impl Simulation<'_> {
    /// Paces the run by the clock, if the plan wants it. The thread gets the priority of real time until the run ends.
    pub(super) fn begin_pace(&mut self) {
        if let Some(factor) = self.plan.execution.real_time {
            self.pace = Some(Box::new(Pace::new(factor)));
            self.components.iter_mut().for_each(|c| c.duration = Some(Default::default()));
        }
    }

    /// Waits until a communication point (s), if the run is paced.
    pub(super) fn wait(&mut self, time: f64) {
        if let Some(pace) = &mut self.pace {
            // A call would be in progress for as long as this waits.
            self.messages.record().end_call();
            pace.wait(time);
        }
    }

    /// [`Simulation::advance`], measured if the run is paced.
    pub(super) fn advance_paced(&mut self, k: u64, time: f64, step: f64) -> CallResult {
        if self.pace.is_none() {
            return self.advance(k, time, step);
        }
        self.components.iter_mut().for_each(|c| c.duration = Some(Default::default()));
        let begin = real_time::now();
        let advanced = self.advance(k, time, step);
        let durations = self.components.iter().filter_map(|component| component.duration);
        if let Some(pace) = &mut self.pace {
            pace.end_step((time, begin), durations, self.plan.experiment.time(k + 1));
        }
        advanced
    }

    /// How well the run has kept the time, if it is paced.
    pub(super) fn punctuality(&self) -> Option<Punctuality> {
        let name = |index: usize| self.plan.components[index].name.clone();
        self.pace.as_ref().map(|pace| pace.punctuality(name))
    }
}

impl ComponentInstance<'_> {
    /// Takes a step of a system that is not plain, measured if the run is paced.
    pub(crate) fn step_measured(&mut self, time: f64, step: f64) -> CallResult {
        let Some(before) = self.duration else { return self.step::<false>(time, step) };
        let begin = real_time::now();
        let stepped = self.step::<false>(time, step);
        self.duration = Some(before + real_time::now().saturating_sub(begin));
        stepped
    }
}
