//! Rows at the ends of the steps of the solver, between the communication points of an FMU whose step nobody has chosen.

use super::{Row, Simulation};

impl Simulation<'_> {
    /// Records the ends of internal steps from now on, if the plan wants it.
    pub(super) fn begin_internal_steps(&mut self) {
        let component = self.components.first_mut().filter(|_| self.plan.records_internal_steps);
        let groups = self.plan.wiring.groups.first();
        if let Some((component, groups)) = component.zip(groups)
            && let Some(integrator) = &mut component.integrator
        {
            integrator.record_internal_steps(groups, self.outputs.clone());
        }
    }

    /// Observes the rows of a communication step; returns false if no more are wanted.
    pub(super) fn observe_internal_steps(
        &mut self,
        observe: &mut impl FnMut(&Row) -> bool,
    ) -> bool {
        let integrator = self.components.first_mut().and_then(|c| c.integrator.as_mut());
        let points = integrator.map(|integrator| integrator.take_internal_steps());
        points.into_iter().flatten().all(|(time, outputs)| {
            self.row.time = time;
            self.row.store.record::<false>(&self.plan.wiring.recorded_before, &outputs);
            observe(&self.row)
        })
    }
}
