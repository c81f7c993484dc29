//! What an FMU tells by `fmi3ClockUpdateCallback` in scheduled execution (FMI 3.0.2, section 5.2).

use std::sync::atomic::Ordering::Relaxed;
use std::sync::atomic::{AtomicBool, AtomicUsize};
use std::sync::{Arc, Mutex};

use fmu_description::{IntervalVariability, XmlVariable};
use fmu_host::{Failure, Instance};

use crate::binary::report::lock;
use crate::binary::schedule::kind;

/// What the FMU tells while it updates its clocks.
#[derive(Default)]
pub struct ClockUpdates {
    /// Whether a partition is active.
    pub is_active: AtomicBool,
    /// Number of updates when none was.
    pub misplaced: AtomicUsize,
    /// What was told since it was taken last.
    pub told: Mutex<Vec<ClockUpdate>>,
}

/// The clocks in an update.
#[derive(Default)]
pub struct ClockUpdate {
    /// The output clocks that are active, and those that are still when they are read again.
    pub active: Vec<u32>,
    pub still: Vec<u32>,
    /// The answers for the countdown clocks, by their indices.
    pub intervals: Vec<(usize, fmu_host::Result<(f64, i32)>)>,
    /// Why the output clocks could not be read.
    pub failure: Option<Failure>,
}

impl ClockUpdates {
    /// Listens to the updates of an instance.
    pub fn of(
        instance: &mut Instance,
        inputs: &[&XmlVariable<'_>],
        outputs: &[&XmlVariable<'_>],
    ) -> Arc<Self> {
        let updates = Arc::new(Self::default());
        let outputs: Vec<u32> = outputs.iter().map(|clock| clock.reference).collect();
        let countdowns = inputs
            .iter()
            .enumerate()
            .filter(|(_, clock)| kind(clock) == IntervalVariability::Countdown);
        let countdowns: Vec<_> = countdowns.map(|(k, clock)| (k, clock.reference)).collect();
        let this = Arc::clone(&updates);
        instance.on_clock_update(move |fmu| {
            if !this.is_active.load(Relaxed) {
                this.misplaced.fetch_add(1, Relaxed);
                return;
            }
            let mut update = ClockUpdate::default();
            let mut read = |into: &mut Vec<u32>| {
                let mut values = vec![0; outputs.len()];
                if let Err(failure) = fmu.get_clock(&outputs, &mut values) {
                    update.failure = Some(failure);
                }
                let active = outputs.iter().zip(values).filter(|(_, value)| *value != 0);
                into.extend(active.map(|(clock, _)| *clock));
            };
            if !outputs.is_empty() {
                let (mut active, mut still) = (Vec::new(), Vec::new());
                read(&mut active);
                read(&mut still);
                (update.active, update.still) = (active, still);
            }
            for (k, clock) in &countdowns {
                let answer = fmu.interval_decimal(*clock);
                let answer = answer.map(|(interval, qualifier)| (interval, qualifier as i32));
                update.intervals.push((*k, answer));
            }
            lock(&this.told).push(update);
        });
        updates
    }
}
