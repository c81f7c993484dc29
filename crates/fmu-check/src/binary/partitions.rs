//! Runs of scheduled execution: the model partitions are activated when their clocks tick, at one time by their
//! priorities (FMI 3.0.2, section 5.2).

use std::sync::atomic::Ordering::Relaxed;

use anyhow::{Context, Result};
use fmu_description::IntervalVariability;
use fmu_file::text::quote;
use fmu_host::{Cause, Failure, IntervalQualifier};

use crate::binary::clock_updates::ClockUpdate;
use crate::binary::report::lock;
use crate::binary::run::Run;
use crate::binary::schedule::{clock_type, kind};
use crate::rule::rule;

const CHANGED: i32 = IntervalQualifier::Changed as i32;

/// Maximum number of activations in a communication step.
const MAX_ACTIVATIONS: usize = 1000;

impl Run<'_> {
    /// Activates the partitions whose clocks tick up to a time (s); a clock that the host triggers ticks then.
    pub fn activate_until(&mut self, end: f64) -> Result<()> {
        for _ in 0..MAX_ACTIVATIONS {
            if self.ended {
                return Ok(());
            }
            let next = self.next_due(end);
            let Some((k, time)) = next else {
                self.position.now = end;
                return Ok(());
            };
            // A partition is activated once at a time.
            if self.position.schedule.activated.insert(k, time).is_some_and(|last| last >= time) {
                break;
            }
            self.position.now = time;
            self.activate(k)?;
        }
        self.end_as_ticks_are_too_many();
        Ok(())
    }

    /// The clock that ticks next, and its time: at one time but for rounding, the clock of the highest priority.
    fn next_due(&self, end: f64) -> Option<(usize, f64)> {
        let clocks = &self.subject.clocks.inputs;
        let due = self.due_until(end);
        let first = due.iter().map(|(_, time)| *time).min_by(f64::total_cmp)?;
        let now = due.into_iter().filter(|(_, time)| *time <= first + self.slack());
        let priority = |k: usize| clock_type(clocks[k]).priority.unwrap_or(u32::MAX);
        let next = now.min_by_key(|(k, _)| (priority(*k), *k))?;
        Some((next.0, first))
    }

    /// Activates the partition of a clock, now.
    pub fn activate(&mut self, k: usize) -> Result<()> {
        let (clock, time) = (self.subject.clocks.inputs[k], self.position.now);
        let (name, active) = (quote(&clock.name), [clock.reference]);
        self.set_inputs(|_| true)?;
        self.set_clocked(&active)?;
        let updates = self.updates.clone().context("it is not instantiated for it")?;
        updates.is_active.store(true, Relaxed);
        let activated = self.instance.activate_model_partition(clock.reference, time);
        updates.is_active.store(false, Relaxed);
        let keeps_lock =
            matches!(&activated, Err(failure) if matches!(failure.cause, Cause::Broke(_)));
        self.expect(rule!("preemption-unlocked"), !keeps_lock, || {
            format!("the model partition of {name} has locked preemption and returned at t = {time} s without unlocking it")
        });
        if !keeps_lock {
            activated.with_context(|| format!("the model partition of {name} at t = {time} s"))?;
        }
        self.ticked(k);
        self.expect(rule!("clock-update"), updates.misplaced.load(Relaxed) == 0, || {
            "the FMU has called fmi3ClockUpdateCallback when no model partition was active".into()
        });
        for update in std::mem::take(&mut *lock(&updates.told)) {
            self.updated(&name, update)?;
        }
        if kind(clock) == IntervalVariability::Changing {
            self.tell_next(k)?;
        }
        self.read_clocked(&active)
    }

    /// Judges what the FMU has told while it updated its clocks, in the partition of a clock.
    fn updated(&mut self, partition: &str, update: ClockUpdate) -> Result<()> {
        if let Some(failure) = update.failure {
            return Err(Failure::into(failure));
        }
        let time = self.position.now;
        self.expect(rule!("clock-read"), update.still.is_empty(), || {
            format!("an output clock is still active when it is read once more in clock update mode at t = {time} s, expected it to be active once")
        });
        self.position.schedule.ticked.extend(&update.active);
        let mut tells = !update.active.is_empty();
        for (k, answer) in update.intervals {
            tells |= answer.as_ref().is_ok_and(|(_, qualifier)| *qualifier == CHANGED);
            let interval = self.answered(self.subject.clocks.inputs[k], answer)?;
            self.next_after(k, interval);
        }
        self.expect(rule!("clock-update"), tells, || {
            format!("the model partition of {partition} has called fmi3ClockUpdateCallback at t = {time} s, but no output clock is active, and no countdown clock has a new interval")
        });
        Ok(())
    }
}
