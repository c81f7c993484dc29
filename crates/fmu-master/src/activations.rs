//! The model partitions of a component that are to be activated, and what its FMU says of its clocks in an activation
//! (FMI 3.0.2, section 5.2).

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use fmu_host::fmi3::fmi3Clock;
use fmu_host::{ClockUpdateMode, Failure, IntervalQualifier};

use crate::ticks::Span;

/// The activations of a component at an instant.
#[derive(Debug, Clone, Default)]
pub(crate) struct Activations {
    /// The input clocks, by their numbers, whose partitions are still to be activated.
    pending: Vec<usize>,
    /// When each input clock has ticked last (s).
    last: Vec<f64>,
    updates: Arc<Mutex<ClockUpdates>>,
}

/// The clocks of an FMU that it may update in an activation, by value reference.
pub(crate) struct UpdatableClocks {
    pub(crate) outputs: Vec<u32>,
    /// The countdown clocks: their numbers, and whether they have fractions.
    pub(crate) countdowns: Vec<(usize, u32, bool)>,
}

/// What an FMU has updated in an activation.
#[derive(Debug, Default)]
pub(crate) struct ClockUpdates {
    /// The output clocks that have ticked, by value reference.
    pub(crate) ticked: Vec<u32>,
    /// The new intervals of countdown clocks, by their numbers.
    pub(crate) intervals: Vec<(usize, Span, IntervalQualifier)>,
    pub(crate) failure: Option<Failure>,
    /// Memory for the states of clocks.
    states: Vec<fmi3Clock>,
}

impl Activations {
    /// Those of an FMU with so many input clocks.
    pub(crate) fn new(inputs: usize) -> Self {
        Self { last: vec![f64::NEG_INFINITY; inputs], ..Self::default() }
    }

    /// Whether no partition is to be activated.
    pub(crate) fn is_empty(&self) -> bool {
        self.pending.is_empty()
    }

    /// Ticks an input clock.
    pub(crate) fn tick(&mut self, clock: usize) {
        if !self.pending.contains(&clock) {
            self.pending.push(clock);
        }
    }

    /// The smallest priority of the clocks whose partitions are to be activated.
    pub(crate) fn priority(&self, priority: impl Fn(usize) -> u32) -> Option<u32> {
        self.pending.iter().map(|clock| priority(*clock)).min()
    }

    /// Takes the clock whose partition is activated next, at a time (s): the one with the smallest priority, of several the
    /// first one. Returns its number, and whether it ticks for the first time at this time.
    pub(crate) fn take(
        &mut self,
        time: f64,
        priority: impl Fn(usize) -> u32,
    ) -> Option<(usize, bool)> {
        let next = self.pending.iter().copied().min_by_key(|clock| (priority(*clock), *clock))?;
        self.pending.retain(|clock| *clock != next);
        let before = std::mem::replace(&mut self.last[next], time);
        Some((next, before < time))
    }

    /// What the FMU updates, in an activation or after it.
    pub(crate) fn updates(&self) -> MutexGuard<'_, ClockUpdates> {
        self.updates.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The function that receives the updates of these clocks.
    pub(crate) fn receiver(
        &self,
        clocks: UpdatableClocks,
    ) -> impl Fn(&mut ClockUpdateMode) + Send + Sync + 'static {
        let updates = Arc::clone(&self.updates);
        move |mode| {
            let mut updates = updates.lock().unwrap_or_else(PoisonError::into_inner);
            let received = updates.receive(&clocks, mode);
            updates.failure = updates.failure.take().or(received.err());
        }
    }
}

impl ClockUpdates {
    /// Asks for the updates, as a host must: an FMU says only once that a clock ticks or has a new interval.
    fn receive(
        &mut self,
        clocks: &UpdatableClocks,
        mode: &mut ClockUpdateMode,
    ) -> Result<(), Failure> {
        let Self { ticked, intervals, states, .. } = self;
        if !clocks.outputs.is_empty() {
            states.clear();
            states.resize(clocks.outputs.len(), 0);
            mode.get_clock(&clocks.outputs, states)?;
            let active = clocks.outputs.iter().zip(states).filter(|(_, state)| **state != 0);
            ticked.extend(active.map(|(clock, _)| *clock));
        }
        for (number, reference, has_fraction) in &clocks.countdowns {
            let (span, qualifier) = match has_fraction {
                true => {
                    let (fraction, qualifier) = mode.interval_fraction(*reference)?;
                    (fraction.into(), qualifier)
                }
                false => {
                    let (seconds, qualifier) = mode.interval_decimal(*reference)?;
                    (Span::Decimal(seconds), qualifier)
                }
            };
            if qualifier == IntervalQualifier::Changed {
                intervals.push((*number, span, qualifier));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partitions_are_activated_by_priority_then_in_the_order_of_their_clocks() {
        let priorities = [2, 0, 1, 0];
        let priority = |clock: usize| priorities[clock];
        let mut activations = Activations::new(4);
        for clock in [0, 2, 3, 1, 3] {
            activations.tick(clock);
        }
        let order = std::iter::from_fn(|| activations.take(1.0, priority));
        assert_eq!(Vec::from_iter(order), [1, 3, 2, 0].map(|clock| (clock, true)));
        assert!(activations.is_empty());
        activations.tick(3);
        assert_eq!(activations.priority(priority), Some(0));
        assert_eq!(activations.take(1.0, priority), Some((3, false)));
        activations.tick(3);
        assert_eq!(activations.take(1.5, priority), Some((3, true)));
    }
}
