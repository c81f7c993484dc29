//! Adaptive steps between two communication points. Each is taken at once and in two halves, from the same state; the
//! difference estimates the error of the halves, of which outputs are held in each step (Richardson's extrapolation).

use super::{Simulation, Snapshot};
use crate::component_instance::CallResult;
use crate::iterated_group::Stage;
use crate::step_control::{AdaptiveSteps, StepControl};
use crate::store::Store;

/// What a run keeps for adaptive steps.
pub(super) struct Adaptive {
    control: StepControl,
    /// The components and the outputs before a step, and the outputs after it.
    before: Snapshot,
    outputs_before: Store,
    coarse: Store,
}

impl Simulation<'_> {
    /// Prepares adaptive steps, if the plan wants them.
    ///
    /// # Errors
    /// The state of a component cannot be saved.
    pub(super) fn prepare_adaptive_steps(&mut self) -> anyhow::Result<()> {
        if let Some(adaptive) = &self.plan.adaptive {
            let before = self.snapshot_of(&adaptive.components)?;
            let control = StepControl::new(adaptive.smallest, self.plan.experiment.step);
            let (outputs_before, coarse) = (self.outputs.clone(), self.outputs.clone());
            self.adaptive = Some(Box::new(Adaptive { control, before, outputs_before, coarse }));
        }
        Ok(())
    }

    /// The adaptive steps so far.
    pub(super) fn adaptive_steps(&self) -> Option<AdaptiveSteps> {
        self.adaptive.as_ref().map(|adaptive| adaptive.control.steps)
    }

    /// Advances from communication point `k` by a step (s): sampled components at once, then the others in adaptive
    /// steps, in which faults do not act again.
    pub(super) fn advance_adaptively(
        &mut self,
        adaptive: &mut Adaptive,
        k: u64,
        time: f64,
        step: f64,
    ) -> CallResult {
        let plan = self.plan;
        let all = plan.schedule.stages.iter();
        let is_sampled = |stage: &&Stage| matches!(stage, Stage::Component(index) if plan.components[*index].sampled);
        let (sampled, others): (Vec<&Stage>, Vec<&Stage>) = all.partition(is_sampled);
        self.advance_stages(&sampled, k, time, step)?;
        let components = plan.adaptive.iter().flat_map(|adaptive| &adaptive.components);
        components.for_each(|index| self.carry(*index, k, time, step));
        self.is_within_step = true;
        let advanced = self.take_adaptive_steps(adaptive, &others, k, time, time + step);
        self.is_within_step = false;
        self.messages.record().step(step);
        advanced
    }

    fn take_adaptive_steps(
        &mut self,
        adaptive: &mut Adaptive,
        stages: &[&Stage],
        k: u64,
        start: f64,
        end: f64,
    ) -> CallResult {
        let Adaptive { control, before, outputs_before, coarse } = adaptive;
        let mut now = start;
        while now < end {
            let left = end - now;
            let count = (left / control.size * (1.0 - 1e-9)).ceil().max(1.0);
            let next = if count > 1.0 { now + left / count } else { end };
            let (size, middle) = (next - now, now + 0.5 * (next - now));
            if now > start {
                self.feed_table(now);
            }
            self.save(*before)?;
            outputs_before.copy_from(&self.outputs);
            self.advance_from(stages, k, now, next)?;
            coarse.copy_from(&self.outputs);
            self.restore(*before)?;
            self.outputs.copy_from(outputs_before);
            self.advance_from(stages, k, now, middle)?;
            self.feed_table(middle);
            self.advance_from(stages, k, middle, next)?;
            if control.accepts(self.error(coarse), now, size) {
                now = next;
            } else {
                self.restore(*before)?;
                self.outputs.copy_from(outputs_before);
            }
        }
        Ok(())
    }

    /// Advances some components from one time to another (s).
    fn advance_from(&mut self, stages: &[&Stage], k: u64, time: f64, end: f64) -> CallResult {
        self.messages.record().at(time);
        self.messages.record().step(end - time);
        let advanced = self.advance_stages(stages, k, time, end - time);
        advanced.map_err(|failure| failure.at(time))
    }

    /// Takes the values of a time (s) within a step from the input table.
    fn feed_table(&mut self, time: f64) {
        if let (Some(table), None) = (&self.plan.input, &self.plan.live) {
            table.apply(time, &self.plan.wiring.table_places, &mut self.outputs);
        }
    }

    /// The largest difference between outputs and those of a coarser step, relative to the allowed one; infinite if one
    /// is not a number.
    fn error(&self, coarse: &Store) -> f64 {
        let Some(adaptive) = &self.plan.adaptive else { return 0.0 };
        let errors = adaptive.outputs.iter().map(|(place, nominal)| {
            let (fine, coarse) = (self.outputs.number(*place), coarse.number(*place));
            let error = (fine - coarse).abs() / (adaptive.tolerance * fine.abs().max(*nominal));
            if error.is_nan() { f64::INFINITY } else { error }
        });
        errors.fold(0.0, f64::max)
    }
}
