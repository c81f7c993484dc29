//! Sample instants: when a sampled controller acts, independent of the host's communication steps.

use serde::{Deserialize, Serialize};

use crate::model::ModelError;

/// An instant within this fraction of the sample time of a communication point counts as lying on
/// it: hosts compute time in floating point, so times are never compared for equality.
const TOLERANCE: f64 = 1e-6;

/// Maximum number of samples in one communication step; more would take minutes to compute.
const MAX_SAMPLES: f64 = 1e8;

/// The index of the next instant before the first step, which leads to the general case of `due`.
const BEFORE_FIRST_STEP: f64 = f64::NEG_INFINITY;

/// The clock of a sampled system, with the instants `start + k ts`, k = 0, 1, ...
///
/// A model with one sample time needs no clock of its own: `#[model(sample_time = ...)]` calls its step
/// at the instants. A clock is for models with several sample times.
///
/// ```
/// use fmu_export::SampleClock;
///
/// let mut clock = SampleClock::new(0.0, 0.001)?;
/// assert_eq!(clock.due(0.0, 0.001)?, 1); // the instant at 0
/// assert_eq!(clock.due(0.001, 0.0005)?, 1); // the instant at 0.001
/// assert_eq!(clock.due(0.0015, 0.0005)?, 0); // 0.002 belongs to the next step
/// # Ok::<(), fmu_export::ModelError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SampleClock {
    start: f64,
    ts: f64,
    /// Sample instants per second; multiplying by the rate is cheaper than dividing by `ts`.
    rate: f64,
    /// Index of the next instant: a whole number, exact up to 2^53, or `BEFORE_FIRST_STEP`.
    next: f64,
}

/// An unset clock, for which every step has too many samples.
impl Default for SampleClock {
    fn default() -> Self {
        Self::UNSET
    }
}

impl SampleClock {
    pub(crate) const UNSET: Self =
        Self { start: 0.0, ts: 0.0, rate: f64::INFINITY, next: BEFORE_FIRST_STEP };

    /// Creates a clock with the first instant `start` (s) and the sample time `ts` (s).
    ///
    /// # Errors
    /// The sample time is not a positive number.
    pub fn new(start: f64, ts: f64) -> Result<Self, ModelError> {
        let rate = 1.0 / ts;
        if !(ts > 0.0 && ts.is_finite() && rate.is_finite()) {
            return Err(ModelError::new(format_args!(
                "the sample time is {ts} s; expected a positive number"
            )));
        }
        Ok(Self { start, ts, rate, next: BEFORE_FIRST_STEP })
    }

    /// Counts the instants in `[time, time + step)` (up to rounding) that were not counted before.
    ///
    /// # Errors
    /// There are more than 100 million instants. The step is discarded: the clock is unchanged.
    #[inline]
    pub fn due(&mut self, time: f64, step: f64) -> Result<u32, ModelError> {
        if self.is_one_due(time, step) {
            self.advance();
            return Ok(1);
        }
        self.count(time, self.samples_to(time + step))
    }

    /// Whether one instant is due, as in most steps. It takes no rounding.
    #[inline(always)]
    pub(crate) fn is_one_due(&self, time: f64, step: f64) -> bool {
        let end = self.samples_to(time + step);
        self.next < end && end <= self.next + 1.0
    }

    /// Counts one instant.
    #[inline(always)]
    pub(crate) fn advance(&mut self) {
        self.next += 1.0;
    }

    /// The general case of [`due`](Self::due), for any number of instants.
    #[inline(never)]
    fn count(&mut self, time: f64, end: f64) -> Result<u32, ModelError> {
        let next = match self.next {
            BEFORE_FIRST_STEP => libm::ceil(self.samples_to(time)).max(0.0),
            next => next,
        };
        let samples = libm::ceil(end - next).max(0.0);
        if samples > MAX_SAMPLES {
            return Err(ModelError::discard(format_args!(
                "the communication step contains {samples} sample instants, more than the maximum of {MAX_SAMPLES}"
            )));
        }
        self.next = next + samples;
        Ok(samples as u32)
    }

    /// Counts the instants up to `time` (up to rounding) that were not counted before.
    ///
    /// # Errors
    /// As [`due`](Self::due).
    pub(crate) fn due_until(&mut self, time: f64) -> Result<u32, ModelError> {
        // The time may come from `next_instant`, whose rounding error exceeds the tolerance if the time
        // is long compared to the sample time.
        let rounding = f64::EPSILON * (time.abs() + self.start.abs()) * self.rate;
        let end = libm::floor(self.samples_to(time) + 2.0 * TOLERANCE + rounding) + 1.0;
        self.count(time, end)
    }

    /// The sample time (s), which stays the same if the variable from which it came changes.
    #[inline]
    pub(crate) fn sample_time(&self) -> f64 {
        self.ts
    }

    /// The next instant that is not counted.
    #[inline]
    pub(crate) fn next_instant(&self) -> f64 {
        self.start + self.next.max(0.0) * self.ts
    }

    /// The instant that is the `count`-th from the end of those that were counted.
    #[inline]
    pub(crate) fn instant_before(&self, count: u32) -> f64 {
        self.start + (self.next - f64::from(count)) * self.ts
    }

    /// The time since the start in sample times, minus the tolerance. Rounded up, it is the number of
    /// instants before `time`.
    #[inline]
    fn samples_to(&self, time: f64) -> f64 {
        (time - self.start) * self.rate - TOLERANCE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_start_drift_and_jitter_neither_lose_nor_repeat_a_sample() {
        for (start, jitter) in [(1e6, 0.0), (0.0, 1e-13)] {
            let mut clock = SampleClock::new(start, 0.001).unwrap();
            let mut time = start;
            for k in 0..20_000 {
                let h = 0.001 + if k % 2 == 0 { jitter } else { -jitter };
                assert_eq!(clock.due(time, h), Ok(1), "step {k}");
                time = if jitter == 0.0 { start + f64::from(k + 1) * 0.001 } else { time + h };
            }
        }
    }

    #[test]
    fn a_step_within_the_tolerance_leaves_its_instant_to_the_next() {
        let mut clock = SampleClock::new(0.0, 0.001).unwrap();
        assert_eq!(clock.due(0.0, 6e-14), Ok(0));
        assert_eq!(clock.due(6e-14, 0.001 - 6e-14), Ok(1));
        assert_eq!(clock.due(0.001, 0.001), Ok(1));
    }

    #[test]
    fn a_first_step_after_the_start_takes_only_its_own_instants() {
        let mut clock = SampleClock::new(0.0, 0.001).unwrap();
        assert_eq!(clock.due(0.5, 0.001), Ok(1));
    }

    #[test]
    fn a_sample_time_must_be_set_and_positive() {
        assert!(SampleClock::default().due(0.0, 0.001).is_err());
        for ts in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-320] {
            assert!(SampleClock::new(0.0, ts).is_err(), "{ts}");
        }
    }

    #[test]
    fn the_next_instant_is_due_at_its_own_time_though_it_is_rounded() {
        for start in [1e6, 1e9, 1e15, -1e12] {
            let mut clock = SampleClock::new(start, 0.001).unwrap();
            for _ in 0..1000 {
                let due = clock.due_until(clock.next_instant()).unwrap();
                assert!(due > 0, "start {start}: {clock:?}");
            }
        }
    }

    #[test]
    fn an_excessive_step_is_rejected_and_changes_nothing() {
        let mut clock = SampleClock::new(0.0, 0.001).unwrap();
        let before = clock;
        assert!(clock.due(0.0, 1e300).is_err());
        assert_eq!(clock, before);
        assert_eq!(clock.due(0.0, 0.001), Ok(1));
    }
}
