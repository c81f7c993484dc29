//! The components with clocks in a run: they advance from tick to tick between two communication points.
//!
//! At a communication point, they get the inputs from components without clocks, and handle the instant. Then all step to
//! the next tick or event, or until one returns early, handle the instant there, and so on. An instant is one or more
//! super-dense instants: in each, components are evaluated in their order, and an output clock that ticks has its triggered
//! clocks tick in the same super-dense instant, or in the next one if their component is evaluated already. Ticks at the
//! end of the step belong to the next communication point.

use anyhow::Result;
use fmu_description::Value;

use super::Simulation;
use crate::clocked_stage::{ClockedStage, Member};
use crate::component_clocks::{ComponentClocks, Part};
use crate::component_instance::CallResult;
use crate::recorded_instance::IntegrationError;
use crate::start::ComponentStarts;
use crate::store::{Store, number};
use crate::ticks::rounding;
use crate::wiring::ClockedColumn;
use crate::{Conversion, Place, Plan};

/// Maximum number of super-dense instants in an instant, and of steps without progress.
const MAX_REPETITIONS: u32 = 1000;

impl Simulation<'_> {
    /// Gives the values of clocked outputs and of clocks that they have until the first tick: the start values of the inputs
    /// that they feed, or else their own.
    pub(super) fn begin_clocked(&mut self, starts: &[ComponentStarts<'_>]) {
        let Plan { wiring, components, .. } = self.plan;
        let outputs = wiring.output_places.iter();
        for (id, place) in outputs.filter(|(id, _)| id.variable(components).is_of_ticks()) {
            let fmu = id.fmu(components);
            let start = fmu.start(id.scalar).cloned();
            let start = start.unwrap_or_else(|| Value::zero(fmu.access_type(id.scalar)));
            self.outputs.set(*place, start);
        }
        for (to, place, conversion) in &wiring.unset {
            let start = starts[to.component].value(to.scalar, to.fmu(components));
            self.outputs.set(
                *place,
                match (conversion, place) {
                    (Some(Conversion { factor, offset }), Place::Real(_)) => {
                        Value::Float64((number(&start) - offset) / factor)
                    }
                    (Some(_), Place::Other(_)) => continue,
                    (None, _) => start,
                },
            );
        }
    }

    /// Holds the outputs of continuous components for those with clocks over a communication step.
    pub(super) fn hold(&mut self) {
        for (from, to) in &self.plan.wiring.held {
            let value = self.outputs.value(*from);
            self.outputs.set(*to, value);
        }
    }

    /// Advances the components with clocks from communication point `k`, at a time (s), by a step (s).
    pub(super) fn advance_clocked(&mut self, k: u64, time: f64, step: f64) -> CallResult {
        self.tick_at_point(k, time, step)?;
        let Some(stage) = &self.plan.schedule.clocked else { return Ok(()) };
        let (end, mut now, mut stalled) = (time + step, time, 0);
        let same = rounding(end, step);
        loop {
            let next = self.next_tick(stage).filter(|next| *next < end - same);
            let target = next.map_or(end, |next| next.max(now));
            let reached = self.step_all(stage, target, step)?;
            stalled = if reached > now { 0 } else { stalled + 1 };
            if stalled > MAX_REPETITIONS {
                return Err(self.endless(stage, format!(
                    "the steps of the components with clocks have ended {MAX_REPETITIONS} times at t = {reached:?} s, without progress"
                )));
            }
            now = reached;
            if now >= end - same {
                break;
            }
            self.tick(stage, now, step).map_err(|failure| failure.at(now))?;
        }
        for member in stage.members.iter().filter(|member| !member.is_scheduled) {
            self.components[member.component].read::<false>(&mut self.outputs)?;
            self.read_derivatives(member.component, end)?;
        }
        Ok(())
    }

    /// Handles the instant at communication point `k`, and takes what is recorded of it.
    pub(super) fn tick_at_point(&mut self, k: u64, time: f64, step: f64) -> CallResult {
        let Some(stage) = &self.plan.schedule.clocked else { return Ok(()) };
        for member in &stage.members {
            // Faults act once in each communication step.
            if !self.is_within_step {
                self.carry(member.component, k, time, step);
            }
            let component = &mut self.components[member.component];
            component.set_parameters(time)?;
            if let Some(clocks) = &mut component.clocks {
                // But for rounding, it has reached the time.
                clocks.time = time;
                if member.has_discrete_inputs {
                    clocks.part = Part::Waiting;
                }
            }
        }
        self.tick(stage, time, step)?;
        for ClockedColumn { component, clocks, from, to } in &self.plan.wiring.clocked_columns {
            let ticking = self.components[*component].clocks.as_ref();
            let has_ticked = ticking.is_some_and(|ticking| ticking.has_ticked(clocks));
            self.row.store.others[*to] = has_ticked.then(|| self.outputs.value(*from));
        }
        let is_row = k.is_multiple_of(self.plan.output_every);
        for member in &stage.members {
            let Some(clocks) = &mut self.components[member.component].clocks else { continue };
            for (clock, place) in &member.recorded {
                self.outputs.set(*place, Value::Boolean(clocks.has_ticked(&[*clock])));
            }
            if is_row {
                clocks.ticked.clear();
            }
        }
        self.row.store.record::<false>(&self.plan.wiring.recorded_at_ticks, &self.outputs);
        Ok(())
    }

    /// The time of the next tick or time event (s).
    fn next_tick(&self, stage: &ClockedStage) -> Option<f64> {
        let clocks = stage.members.iter().map(|m| self.components[m.component].clocks.as_ref());
        clocks.flatten().filter_map(|clocks| clocks.next()).reduce(f64::min)
    }

    /// Makes room for the states to which components return that step too far, because another one returns early.
    pub(super) fn prepare_returns(&mut self) -> Result<()> {
        let Some(stage) = &self.plan.schedule.clocked else { return Ok(()) };
        let may_return_early = |number: &usize| {
            let component = stage.members[*number].component;
            self.plan.components[component].fmu.may_return_early
        };
        self.returns = vec![None; stage.members.len()];
        // Nothing steps too far after the last one that may return early.
        let early = Vec::from_iter(stage.stepping.iter().copied().filter(may_return_early));
        for number in early.iter().rev().skip(1) {
            let component = stage.members[*number].component;
            if self.plan.components[component].check_savable(false).is_ok() {
                self.returns[*number] = Some(self.snapshot_of(&[component])?);
            }
        }
        Ok(())
    }

    /// Has all components step to a time (s), or to where one of them returns early, and returns that time. Those that have
    /// stepped further return to their states before the step, and step to that time, if they can.
    fn step_all(&mut self, stage: &ClockedStage, target: f64, step: f64) -> CallResult<f64> {
        let (mut reached, same) = (target, rounding(target, step));
        for number in stage.stepping.iter().copied() {
            if let Some(before) = self.returns[number] {
                self.save(before)?;
            }
            let member = &stage.members[number];
            let component = &mut self.components[member.component];
            let time = |clocks: &Option<Box<ComponentClocks>>| {
                clocks.as_ref().map_or(target, |clocks| clocks.time)
            };
            if time(&component.clocks) >= reached - same {
                continue;
            }
            if !member.has_discrete_inputs && !member.is_scheduled {
                component.recorded.calls.begin(None);
                component.write::<false>(&self.outputs)?;
            }
            component.step_to(reached, step)?;
            reached = reached.min(time(&component.clocks));
        }
        for (number, member) in stage.members.iter().enumerate() {
            let clocks = &self.components[member.component].clocks;
            let is_ahead = clocks.as_ref().is_some_and(|clocks| clocks.time > reached + same);
            if let (Some(before), true) = (self.returns[number], is_ahead) {
                self.restore(before)?;
                self.components[member.component].step_to(reached, step)?;
            }
        }
        Ok(reached)
    }

    /// Handles the instant at a time (s): the ticks and events that are due, and those that follow from them.
    fn tick(&mut self, stage: &ClockedStage, time: f64, step: f64) -> CallResult {
        let same = rounding(time, step);
        for member in &stage.members {
            if let Some(clocks) = &mut self.components[member.component].clocks {
                clocks.begin_instant(&member.inputs, time, same);
            }
        }
        for _ in 0..MAX_REPETITIONS {
            while let Some(number) = self.first_waiting(stage) {
                self.evaluate(stage, number, time, same)?;
            }
            for member in &stage.members {
                let component = &mut self.components[member.component];
                if component.clocks.as_ref().is_some_and(|c| c.part == Part::Evaluated) {
                    component.end_instant(member, time, same)?;
                }
            }
            if self.first_waiting(stage).is_none() {
                self.leave_event_mode(stage)?;
                self.notice_inputs(stage);
                if self.first_waiting(stage).is_none() {
                    return Ok(());
                }
            }
        }
        let ticking = self.ticking(stage).join(", ");
        let what = match ticking.is_empty() {
            true => "of discrete states".to_owned(),
            false => format!("of these clocks, which tick again and again: {ticking}"),
        };
        Err(self.endless(
            stage,
            format!("the event at t = {time:?} s needs more than {MAX_REPETITIONS} updates {what}"),
        ))
    }

    /// Returns to step mode, and gets the outputs as they are after the last update of discrete states.
    fn leave_event_mode(&mut self, stage: &ClockedStage) -> CallResult {
        for member in &stage.members {
            let component = &mut self.components[member.component];
            if component.is_in_event_mode() {
                component.leave_event_mode()?;
                component.recorded.calls.begin(None);
                component.read::<false>(&mut self.outputs)?;
            }
        }
        Ok(())
    }

    /// The number of the member that is evaluated next.
    fn first_waiting(&self, stage: &ClockedStage) -> Option<usize> {
        let waiting = stage.members.iter().enumerate().filter_map(|(number, member)| {
            let clocks = self.components[member.component].clocks.as_ref()?;
            let order = (member.level, clocks.priority(&member.inputs), number);
            (clocks.part == Part::Waiting).then_some(order)
        });
        waiting.min().map(|(_, _, number)| number)
    }

    /// Evaluates a member, and ticks the triggered clocks of its clocks that tick.
    fn evaluate(
        &mut self,
        stage: &ClockedStage,
        number: usize,
        time: f64,
        same: f64,
    ) -> CallResult {
        let member = &stage.members[number];
        let component = &mut self.components[member.component];
        match member.is_scheduled {
            true => component.activate_partition(member, &mut self.outputs, time)?,
            false => component.evaluate(member, &mut self.outputs)?,
        }
        if let Some(clocks) = &mut component.clocks {
            see(&mut clocks.seen, member, &self.outputs);
        }
        for (clock, targets) in member.triggers() {
            let clocks = &self.components[member.component].clocks;
            if !clocks.as_ref().is_some_and(|c| c.active().contains(&clock)) {
                continue;
            }
            for (target, reference) in targets {
                let target = &stage.members[*target];
                if let Some(clocks) = &mut self.components[target.component].clocks {
                    clocks.trigger(&target.inputs, *reference);
                }
            }
        }
        if let (true, Some(clocks)) =
            (member.is_scheduled, &mut self.components[member.component].clocks)
        {
            clocks.end_activation(&member.inputs, time, same);
        }
        self.notice_inputs(stage);
        Ok(())
    }

    /// Has members take part whose discrete inputs were changed by others.
    fn notice_inputs(&mut self, stage: &ClockedStage) {
        for member in stage.members.iter().filter(|member| !member.watched.is_empty()) {
            let Some(clocks) = &mut self.components[member.component].clocks else { continue };
            let differs = |(place, seen): (&_, &Value)| {
                let value = self.outputs.value(*place);
                let are_nan = [&value, seen].map(|value| value.as_real().is_some_and(f64::is_nan));
                value != *seen && are_nan != [true; 2]
            };
            if clocks.part == Part::None && member.watched.iter().zip(&clocks.seen).any(differs) {
                clocks.part = Part::Waiting;
            }
        }
    }

    /// The names of the clocks that tick now.
    fn ticking<'a>(&self, stage: &'a ClockedStage) -> Vec<&'a str> {
        let mut names = Vec::new();
        for member in &stage.members {
            let Some(clocks) = &self.components[member.component].clocks else { continue };
            let inputs = member.inputs.iter().map(|clock| (clock.reference, &*clock.name));
            names.extend(inputs.filter(|(r, _)| clocks.active().contains(r)).map(|(_, name)| name));
        }
        names
    }

    /// The error of an instant that does not end.
    fn endless(&mut self, stage: &ClockedStage, reason: String) -> Box<crate::RunError> {
        let is_waiting = |member: &&Member| {
            let clocks = self.components[member.component].clocks.as_ref();
            clocks.is_some_and(|clocks| clocks.part == Part::Waiting)
        };
        let waiting = stage.members.iter().find(is_waiting).unwrap_or(&stage.members[0]);
        let error = IntegrationError::Equations { reason, is_discarded: false, advice: None };
        self.components[waiting.component].integration_error(error, String::new())
    }
}

/// Takes the values of the inputs that are watched.
fn see(seen: &mut Vec<Value>, member: &Member, outputs: &Store) {
    seen.clear();
    seen.extend(member.watched.iter().map(|place| outputs.value(*place)));
}
