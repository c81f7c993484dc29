//! The clocks of a component in a run, at an instant or between two: what ticks now, and the ticks that are to come.

use fmu_description::Value;
use fmu_host::fmi3::fmi3Clock;

use crate::clocked_stage::InputClock;
use crate::ticks::Ticks;

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
    pub(crate) fn trigger(&mut self, clock: u32) {
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
        let active = inputs.iter().filter(|clock| self.active.contains(&clock.reference));
        active.map(|clock| clock.priority).min().unwrap_or(u32::MAX)
    }
}
