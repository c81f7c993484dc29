//! What a system that is not plain does between two communication points.

use std::borrow::Borrow;

use super::Simulation;
use crate::component_instance::CallResult;
use crate::iterated_group::Stage;
use crate::rate::Rate;
use crate::{LoadedComponent, Order, Plan};

impl Simulation<'_> {
    /// Advances from communication point `k`, at a time (s), by a step (s), which may be another one than that of the
    /// experiment unless a component has a step of its own: passes values to inputs, has the components step in their
    /// order, and gets their outputs. Records nothing, and takes values from the input file only within the step.
    pub(crate) fn advance(&mut self, k: u64, time: f64, step: f64) -> CallResult {
        self.hold();
        if let Some(mut adaptive) = self.adaptive.take() {
            let advanced = self.advance_adaptively(&mut adaptive, k, time, step);
            self.adaptive = Some(adaptive);
            return advanced;
        }
        if let Some(crew) = self.crew.clone() {
            return self.advance_with(&crew, k, time, step);
        }
        self.advance_stages(&self.plan.schedule.stages, k, time, step)
    }

    /// Advances some components.
    pub(super) fn advance_stages(
        &mut self,
        stages: &[impl Borrow<Stage>],
        k: u64,
        time: f64,
        step: f64,
    ) -> CallResult {
        let mut stages = stages.iter().map(Borrow::borrow);
        if self.plan.order != Order::Parallel {
            return stages.try_for_each(|stage| match *stage {
                Stage::Component(index) => self.advance_component(index, k, time, step),
                Stage::Group(number) => self.advance_group(number, k, time, step),
                Stage::Clocked => self.advance_clocked(k, time, step),
            });
        }
        let all = stages.filter_map(|stage| match stage {
            Stage::Component(index) => Some(*index),
            Stage::Group(_) | Stage::Clocked => None,
        });
        for index in all.clone() {
            self.feed_component(index, k, time, step)?;
        }
        for index in all.clone() {
            self.step_component(index, k, time, step)?;
        }
        self.advance_clocked(k, time, step)?;
        all.into_iter().try_for_each(|index| self.read_component(index, k, time + step))
    }

    /// Advances a component with the newest inputs.
    pub(super) fn advance_component(
        &mut self,
        index: usize,
        k: u64,
        time: f64,
        step: f64,
    ) -> CallResult {
        self.feed_component(index, k, time, step)?;
        self.step_component(index, k, time, step)?;
        self.read_component(index, k, time + step)
    }

    /// Passes the newest outputs to the inputs of a component that steps now, by connections that may have faults, after
    /// its tunable parameters that change.
    pub(super) fn feed_component(
        &mut self,
        index: usize,
        k: u64,
        time: f64,
        step: f64,
    ) -> CallResult {
        // Faults act once in each communication step.
        if !self.is_within_step {
            self.carry(index, k, time, step);
        }
        if !self.is_due(index, k) {
            return Ok(());
        }
        self.prepare_inputs(index, time, step)?;
        let inputs = &self.plan.wiring.extrapolation.inputs[index];
        self.components[index].write_at(inputs, time, &mut self.outputs)
    }

    /// Passes outputs to a component by the connections that have faults.
    pub(super) fn carry(&mut self, index: usize, k: u64, time: f64, step: f64) {
        let connections = self.faulty_connections[index].iter_mut();
        connections.for_each(|connection| connection.carry(k, time, step, &mut self.outputs));
    }

    /// Prepares a component for the inputs of a step from a time (s): in event mode if it must be, with its tunable
    /// parameters that change.
    fn prepare_inputs(&mut self, index: usize, time: f64, step: f64) -> CallResult {
        self.components[index].prepare_inputs(time, step)?;
        self.components[index].set_parameters(time)
    }

    /// Has a component take its steps in this communication step.
    pub(super) fn step_component(
        &mut self,
        index: usize,
        k: u64,
        time: f64,
        step: f64,
    ) -> CallResult {
        let rate = self.plan.components[index].rate;
        if rate.is_of_system() {
            return self.components[index].step_measured(time, step);
        }
        if !self.is_due(index, k) {
            return Ok(());
        }
        for (number, time) in rate.times(k, self.plan.experiment.start).enumerate() {
            self.messages.record().at(time);
            self.messages.record().step(rate.step);
            let stepped = match number {
                0 => Ok(()),
                _ => self.feed_within_step(index, time),
            };
            let stepped =
                stepped.and_then(|()| self.components[index].step_measured(time, rate.step));
            stepped.map_err(|failure| failure.at(time))?;
        }
        self.messages.record().at(time);
        self.messages.record().step(step);
        Ok(())
    }

    /// Sets what changes of a component within a communication step, for one of its steps in it (s).
    fn feed_within_step(&mut self, index: usize, time: f64) -> CallResult {
        self.prepare_inputs(index, time, self.plan.components[index].rate.step)?;
        let wiring = &self.plan.wiring;
        let inputs = &wiring.extrapolation.inputs[index];
        let table =
            self.plan.input.as_ref().filter(|table| table.feeds(index) && self.plan.live.is_none());
        if let Some(table) = table {
            table.apply_to(index, time, &wiring.table_places, &mut self.outputs);
        } else if inputs.is_empty() {
            return Ok(());
        }
        self.components[index].write_at(inputs, time, &mut self.outputs)
    }

    /// Whether inputs of a component change within a communication step: by a table, unless its rows arrive meanwhile, or by
    /// extrapolation.
    pub(super) fn is_fed_within_step(&self, index: usize) -> bool {
        let Plan { input, live, components, wiring, .. } = self.plan;
        let has_table = || input.as_ref().is_some_and(|input| input.feeds(index));
        let is_fed =
            || !wiring.extrapolation.inputs[index].is_empty() || has_table() && live.is_none();
        components[index].rate.steps > 1 && is_fed()
    }

    /// Gets the outputs of a component at their time: of a sampled one after its step, of others when the communication
    /// steps reach the end of its step (s).
    pub(super) fn read_component(&mut self, index: usize, k: u64, end: f64) -> CallResult {
        let LoadedComponent { rate, sampled, .. } = self.plan.components[index];
        let is_time = if sampled { self.is_due(index, k) } else { rate.ends(k) };
        if is_time {
            self.components[index].read::<false>(&mut self.outputs)?;
            self.read_derivatives(index, end)?;
        }
        Ok(())
    }

    /// Gets the derivatives of the outputs of a component that extrapolate inputs, at a time (s).
    pub(super) fn read_derivatives(&mut self, index: usize, time: f64) -> CallResult {
        let derivatives = &self.plan.wiring.extrapolation.outputs[index];
        self.components[index].read_derivatives(derivatives, time, &mut self.outputs)
    }

    /// Whether a component steps from communication point `k`. A step that would end after the last communication point
    /// is only taken for a sample.
    pub(super) fn is_due(&self, index: usize, k: u64) -> bool {
        let LoadedComponent { rate: rate @ Rate { every, .. }, sampled, .. } =
            self.plan.components[index];
        rate.is_due(k) && (sampled || every == 1 || k + every <= self.plan.communication_steps())
    }
}
