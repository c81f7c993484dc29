//! The steps of components in several threads.

use super::Simulation;
use crate::component_instance::CallResult;
use crate::crew::Crew;

impl<'a> Simulation<'a> {
    /// [`Simulation::advance`] with a crew.
    pub(super) fn advance_with(
        &mut self,
        crew: &Crew<'a>,
        k: u64,
        time: f64,
        step: f64,
    ) -> CallResult {
        for batch in &self.plan.batches {
            for &index in batch {
                self.feed_component(index, k, time, step)?;
            }
            self.step_together(crew, batch, k, (time, step))?;
            for &index in batch {
                self.read_component(index, k, time + step)?;
            }
        }
        Ok(())
    }

    /// Has the components of a batch take their steps in a communication step, those at the same time that can.
    fn step_together(
        &mut self,
        crew: &Crew<'a>,
        batch: &[usize],
        k: u64,
        (time, step): (f64, f64),
    ) -> CallResult {
        let (due, alone) = batch.iter().copied().partition::<Vec<_>, _>(|&index| {
            self.is_due(index, k) && !self.is_fed_within_step(index)
        });
        if due.len() > 1 {
            // Calls are recorded by thread meanwhile.
            self.messages.record().end_call();
            crew.advance(&mut self.components, &due, k, (time, step))?;
        }
        let alone = if due.len() > 1 { alone } else { batch.to_vec() };
        alone.into_iter().try_for_each(|index| self.step_component(index, k, time, step))
    }
}
