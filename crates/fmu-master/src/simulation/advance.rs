//! What a system that is not plain does between two communication points.

use super::Simulation;
use crate::Order;
use crate::component_instance::CallResult;

impl Simulation<'_> {
    /// Advances from communication point `k`, at a time (s), by a step (s), which may be another one than that of the
    /// experiment: passes values to inputs, has the components step in their order, and gets their outputs. Neither
    /// records nor takes values from the input file.
    pub(crate) fn advance(&mut self, k: u64, time: f64, step: f64) -> CallResult {
        let is_sequential = self.plan.order == Order::Sequential;
        for index in 0..self.components.len() {
            self.feed_component(index, k, time, step)?;
            if is_sequential {
                self.step_component(index, time, step)?;
            }
        }
        if !is_sequential {
            for index in 0..self.components.len() {
                self.step_component(index, time, step)?;
            }
        }
        Ok(())
    }

    /// Sets the tunable parameters of a component that change, and passes the newest outputs to its inputs, by connections
    /// that may have faults.
    fn feed_component(&mut self, index: usize, k: u64, time: f64, step: f64) -> CallResult {
        self.components[index].set_parameters(time)?;
        let connections = self.faulty_connections[index].iter_mut();
        connections.for_each(|connection| connection.carry(k, time, step, &mut self.outputs));
        self.components[index].write::<false>(&self.outputs)
    }

    /// Has a component step, and gets its outputs.
    fn step_component(&mut self, index: usize, time: f64, step: f64) -> CallResult {
        let component = &mut self.components[index];
        component.step_measured(time, step)?;
        component.read::<false>(&mut self.outputs)
    }
}
