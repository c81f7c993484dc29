//! The clocks of an instance: which model partitions a host activates, and when they tick. They are the sample clocks of
//! a model with sample times in scheduled execution.

use fmi_abi::fmi3::{fmi3IntervalChanged, fmi3IntervalQualifier, fmi3IntervalUnchanged};

use crate::error::{ModelError, ensure};
use crate::instance::{ClockUpdate, Instance};

/// What the clocks of a model do. A model without clocks has none of it in its binary.
pub(crate) trait Clocks: Sync {
    /// Computes the model partition of a clock at a time (s), at which it has not been computed before.
    fn activate(&self, instance: &mut Instance, clock: u32, time: f64) -> Result<(), ModelError>;

    /// The interval of a clock, and what it means now.
    fn interval(&self, instance: &mut Instance, clock: u32) -> Result<Interval, ModelError>;

    /// The delay (s) of the first tick of a clock.
    fn shift(&self, instance: &mut Instance, clock: u32) -> Result<f64, ModelError>;

    /// A time of a clock (s) as a counter and its resolution.
    fn fraction(
        &self,
        instance: &Instance,
        clock: u32,
        time: f64,
    ) -> Result<(u64, u64), ModelError>;

    /// Whether an activation has news for the host: an output clock has ticked, or an interval is known.
    fn has_update(&self, _instance: &Instance) -> bool {
        false
    }
}

/// The interval of a clock (s), as the host last heard of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Interval {
    Unchanged(f64),
    Changed(f64),
}

impl Interval {
    fn in_c(self) -> (f64, fmi3IntervalQualifier) {
        match self {
            Self::Unchanged(interval) => (interval, fmi3IntervalUnchanged),
            Self::Changed(interval) => (interval, fmi3IntervalChanged),
        }
    }
}

impl Instance {
    /// The clocks of the model, of which every function for clocks needs some.
    fn clocks(&self) -> Result<&'static dyn Clocks, ModelError> {
        self.shared.clocks.ok_or_else(|| ModelError::refuse("the model has no clocks"))
    }

    pub(crate) fn activate_model_partition(
        &mut self,
        clock: u32,
        time: f64,
    ) -> Result<(), ModelError> {
        ensure!(time.is_finite(), "the activation time is {time:?}; expected a finite number");
        self.clocks()?.activate(self, clock, time).map_err(ModelError::not_discarded)
    }

    /// The callback to tell the host of news about clocks, if there are some.
    pub(crate) fn clock_update(&self) -> Option<ClockUpdate> {
        let has_update = self.shared.clocks.is_some_and(|clocks| clocks.has_update(self));
        self.shared.settings.clock_update.clone().filter(|_| has_update)
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
