//! The clocks of a component in a run, at an instant or between two: what ticks now, and the ticks that are to come.

use fmu_description::Value;
use fmu_host::fmi3::fmi3Clock;

use crate::activations::{Activations, ClockUpdates};
use crate::clocked_stage::InputClock;
use crate::ticks::{Span, Ticks};

/// What a component has to do with a super-dense instant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Part {
    #[default]
    None,
    /// It is still to be evaluated.
    Waiting,
    Evaluated,
}

/// A component with clocks at an instant, or between two.
#[derive(Debug, Clone, Default)]
pub(crate) struct ComponentClocks {
    /// The time that it has reached (s).
    pub(crate) time: f64,
    /// The ticks of its input clocks; `None` for triggered ones.
    pub(crate) ticks: Vec<Option<Ticks>>,
    /// The clocks that tick at this super-dense instant, by value reference, and those that tick at the next one.
    pub(crate) active: Vec<u32>,
    pub(crate) deferred: Vec<u32>,
    /// The clocks that have ticked since the last row, and those that have ticked in this event mode.
    pub(crate) ticked: Vec<u32>,
    pub(crate) ticked_in_mode: Vec<u32>,
    /// The next time event (s).
    pub(crate) next_event: Option<f64>,
    /// Whether an event is not handled yet.
    pub(crate) is_due: bool,
    pub(crate) is_entered: bool,
    pub(crate) part: Part,
    /// Its activations in scheduled execution, in which it has no event mode.
    pub(crate) activations: Option<Activations>,
    /// The values of its inputs that are [watched](crate::clocked_stage::Member::watched), when it was evaluated last.
    pub(crate) seen: Vec<Value>,
    /// Memory for the arguments of calls.
    pub(crate) references: Vec<u32>,
    pub(crate) states: Vec<fmi3Clock>,
}

/// Adds an element unless it is there.
pub(crate) fn insert(set: &mut Vec<u32>, element: u32) {
    if !set.contains(&element) {
        set.push(element);
    }
}

impl ComponentClocks {
    /// The clocks that tick at this super-dense instant.
    pub(crate) fn active(&self) -> &[u32] {
        &self.active
    }

    /// Whether one of these clocks has ticked since the last row.
    pub(crate) fn has_ticked(&self, clocks: &[u32]) -> bool {
        clocks.iter().any(|clock| self.ticked.contains(clock))
    }

    /// The time of its next tick or time event (s).
    pub(crate) fn next(&self) -> Option<f64> {
        let ticks = self.ticks.iter().flatten().filter_map(Ticks::next);
        ticks.chain(self.next_event).reduce(f64::min)
    }

    /// Takes part in the super-dense instant at a time (s), or within `same` of it, if a clock ticks or an event is due.
    pub(crate) fn begin_instant(&mut self, inputs: &[InputClock], time: f64, same: f64) {
        if let Some(activations) = &mut self.activations {
            for (number, (ticks, clock)) in self.ticks.iter_mut().zip(inputs).enumerate() {
                let Some(ticks) = ticks else { continue };
                if ticks.next().is_some_and(|next| next <= time + same) {
                    clock.tick(ticks, time + same);
                    activations.tick(number);
                }
            }
            self.part = if activations.is_empty() { Part::None } else { Part::Waiting };
            return;
        }
        for (ticks, clock) in self.ticks.iter().zip(inputs) {
            if ticks.as_ref().and_then(Ticks::next).is_some_and(|next| next <= time + same) {
                insert(&mut self.active, clock.reference);
            }
        }
        if !self.active.is_empty()
            || self.is_due
            || self.next_event.is_some_and(|next| next <= time + same)
        {
            self.part = Part::Waiting;
        }
    }

    /// Ticks a triggered clock: now, or at the next super-dense instant if the component is evaluated.
    pub(crate) fn trigger(&mut self, inputs: &[InputClock], clock: u32) {
        let number = inputs.iter().position(|known| known.reference == clock);
        if let (Some(activations), Some(number)) = (&mut self.activations, number) {
            activations.tick(number);
            self.part = Part::Waiting;
            return;
        }
        match self.part {
            Part::Evaluated => insert(&mut self.deferred, clock),
            Part::None | Part::Waiting => {
                insert(&mut self.active, clock);
                self.part = Part::Waiting;
            }
        }
    }

    /// The smallest priority of the input clocks that tick.
    pub(crate) fn priority(&self, inputs: &[InputClock]) -> u32 {
        if let Some(activations) = &self.activations {
            return activations.priority(|clock| inputs[clock].priority).unwrap_or(u32::MAX);
        }
        let active = inputs.iter().filter(|clock| self.active.contains(&clock.reference));
        active.map(|clock| clock.priority).min().unwrap_or(u32::MAX)
    }

    /// Begins scheduled execution.
    pub(crate) fn begin_activations(&mut self, activations: Activations) {
        (self.is_due, self.is_entered) = (false, false);
        self.activations = Some(activations);
    }

    /// Whether it is scheduled execution.
    pub(crate) fn is_scheduled(&self) -> bool {
        self.activations.is_some()
    }

    /// Begins an activation at a time (s): of the clock with this number, which ticks alone, and whether it ticks for the
    /// first time at this time.
    pub(crate) fn begin_activation(
        &mut self,
        inputs: &[InputClock],
        time: f64,
    ) -> Option<(usize, bool)> {
        let activations = self.activations.as_mut()?;
        let (number, is_first) = activations.take(time, |clock| inputs[clock].priority)?;
        let clock = inputs[number].reference;
        self.active.clear();
        self.active.push(clock);
        insert(&mut self.ticked, clock);
        Some((number, is_first))
    }

    /// Takes what the FMU has updated in an activation. The output clocks that it has ticked are active, too.
    pub(crate) fn take_updates(&mut self) -> ClockUpdates {
        let Some(activations) = &self.activations else { return ClockUpdates::default() };
        let updates = std::mem::take(&mut *activations.updates());
        for clock in &updates.ticked {
            insert(&mut self.active, *clock);
            insert(&mut self.ticked, *clock);
        }
        updates
    }

    /// Ends an activation at a time (s). Countdown clocks may tick at once.
    pub(crate) fn end_activation(&mut self, inputs: &[InputClock], time: f64, same: f64) {
        self.active.clear();
        self.begin_instant(inputs, time, same);
    }

    /// Has an input clock tick after an interval from an event (s), or at no known time.
    pub(crate) fn restart(&mut self, number: usize, event: f64, interval: Option<Span>) {
        if let Some(ticks) = &mut self.ticks[number] {
            match interval {
                Some(interval) => ticks.restart(event, interval),
                None => *ticks = Ticks::Next(None),
            }
        }
    }
}
