//! The clocks of an instance: which model partitions a host activates, and when they tick. They are the sample clocks of
//! a model with sample times in scheduled execution.

use std::thread;

use fmi_abi::fmi3::{
    fmi3Clock, fmi3IntervalChanged, fmi3IntervalNotYetKnown, fmi3IntervalQualifier,
    fmi3IntervalUnchanged,
};
use fmu_description::Number;

use crate::error::{ModelError, ensure};
use crate::instance::{ClockUpdate, Clocks, Instance, Interval};

impl Interval {
    fn in_c(self) -> (f64, fmi3IntervalQualifier) {
        match self {
            Self::NotYetKnown => (0.0, fmi3IntervalNotYetKnown),
            Self::Unchanged(interval) => (interval, fmi3IntervalUnchanged),
            Self::Changed(interval) => (interval, fmi3IntervalChanged),
        }
    }
}

impl Instance {
    /// The clocks of the model, of which every function for clocks needs some.
    fn clocks(&self) -> Result<&'static dyn Clocks, ModelError> {
        self.shared.clocks().ok_or_else(|| ModelError::refuse("the model has no clocks"))
    }

    pub(crate) fn activate_model_partition(
        &mut self,
        clock: u32,
        time: f64,
    ) -> Result<(), ModelError> {
        ensure!(
            time.is_finite(),
            "the activation time is {:?}; expected a finite number",
            Number(time)
        );
        self.clocks()?.activate(self, clock, time).map_err(ModelError::not_discarded)
    }

    /// Begins to tell the host of news about clocks, if there are some: returns the callback, after which
    /// [`end_clock_update`](Self::end_clock_update) follows. A host may preempt the callback by an activation on another
    /// thread, where the instance is not in clock update mode.
    pub(crate) fn begin_clock_update(&mut self) -> Option<ClockUpdate> {
        let has_update = self.shared.clocks().is_some_and(|clocks| clocks.has_update(self));
        let scheduling = self.shared.settings.scheduling().filter(|_| has_update)?;
        let update = scheduling.clock_update.clone()?;
        scheduling.updating.borrow_mut().push(thread::current().id());
        Some(update)
    }

    pub(crate) fn end_clock_update(&mut self) {
        let Some(scheduling) = self.shared.settings.scheduling() else { return };
        let mut updating = scheduling.updating.borrow_mut();
        let own = thread::current().id();
        if let Some(place) = updating.iter().rposition(|thread| *thread == own) {
            updating.remove(place);
        }
    }

    pub(crate) fn get_clock(
        &mut self,
        references: &[u32],
        values: &mut [fmi3Clock],
    ) -> Result<(), ModelError> {
        self.clocks()?.get(self, references, values)
    }

    pub(crate) fn set_clock(
        &mut self,
        references: &[u32],
        values: &[fmi3Clock],
    ) -> Result<(), ModelError> {
        self.clocks()?.set(self, references, values)
    }

    pub(crate) fn evaluate_discrete_states(&mut self) -> Result<(), ModelError> {
        self.clocks()?.evaluate(self)
    }

    pub(crate) fn set_interval_decimal(
        &mut self,
        references: &[u32],
        intervals: &[f64],
    ) -> Result<(), ModelError> {
        let clocks = self.clocks()?;
        let mut each = references.iter().zip(intervals);
        each.try_for_each(|(&clock, &interval)| clocks.set_interval(self, clock, interval))
    }

    pub(crate) fn set_interval_fraction(
        &mut self,
        references: &[u32],
        counters: &[u64],
        resolutions: &[u64],
    ) -> Result<(), ModelError> {
        let intervals = quotients(counters, resolutions)?;
        self.set_interval_decimal(references, &intervals)
    }

    pub(crate) fn set_shift_decimal(
        &mut self,
        references: &[u32],
        shifts: &[f64],
    ) -> Result<(), ModelError> {
        let clocks = self.clocks()?;
        let mut each = references.iter().zip(shifts);
        each.try_for_each(|(&clock, &shift)| clocks.set_shift(self, clock, shift))
    }

    pub(crate) fn set_shift_fraction(
        &mut self,
        references: &[u32],
        counters: &[u64],
        resolutions: &[u64],
    ) -> Result<(), ModelError> {
        let shifts = quotients(counters, resolutions)?;
        self.set_shift_decimal(references, &shifts)
    }

    pub(crate) fn get_interval_decimal(
        &mut self,
        references: &[u32],
        intervals: &mut [f64],
        qualifiers: &mut [fmi3IntervalQualifier],
    ) -> Result<(), ModelError> {
        let clocks = self.clocks()?;
        for ((&clock, interval), qualifier) in references.iter().zip(intervals).zip(qualifiers) {
            (*interval, *qualifier) = clocks.interval(self, clock)?.in_c();
        }
        Ok(())
    }

    pub(crate) fn get_interval_fraction(
        &mut self,
        references: &[u32],
        counters: &mut [u64],
        resolutions: &mut [u64],
        qualifiers: &mut [fmi3IntervalQualifier],
    ) -> Result<(), ModelError> {
        let clocks = self.clocks()?;
        let fractions = counters.iter_mut().zip(resolutions);
        for ((&clock, fraction), qualifier) in references.iter().zip(fractions).zip(qualifiers) {
            let (interval, of_interval) = clocks.interval(self, clock)?.in_c();
            (*fraction.0, *fraction.1) = clocks.fraction(self, clock, interval)?;
            *qualifier = of_interval;
        }
        Ok(())
    }

    pub(crate) fn get_shift_decimal(
        &mut self,
        references: &[u32],
        shifts: &mut [f64],
    ) -> Result<(), ModelError> {
        let clocks = self.clocks()?;
        for (&clock, shift) in references.iter().zip(shifts) {
            *shift = clocks.shift(self, clock)?;
        }
        Ok(())
    }

    pub(crate) fn get_shift_fraction(
        &mut self,
        references: &[u32],
        counters: &mut [u64],
        resolutions: &mut [u64],
    ) -> Result<(), ModelError> {
        let clocks = self.clocks()?;
        for ((&clock, counter), resolution) in references.iter().zip(counters).zip(resolutions) {
            let shift = clocks.shift(self, clock)?;
            (*counter, *resolution) = clocks.fraction(self, clock, shift)?;
        }
        Ok(())
    }
}

/// Times (s) from counters and resolutions.
fn quotients(counters: &[u64], resolutions: &[u64]) -> Result<Vec<f64>, ModelError> {
    ensure!(!resolutions.contains(&0), "a resolution is 0; expected a positive number");
    let fractions = counters.iter().zip(resolutions);
    Ok(fractions.map(|(&counter, &resolution)| counter as f64 / resolution as f64).collect())
}
