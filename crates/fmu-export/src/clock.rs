//! Sample instants: when a sampled controller acts, independent of the host's communication steps.

use serde_core::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::ModelError;
use crate::saved::saved;

/// An instant within this fraction of the sample time of a communication point counts as lying on
/// it: hosts compute time in floating point, so times are never compared for equality.
const TOLERANCE: f64 = 1e-6;

/// Maximum number of samples in one communication step; more would take minutes to compute.
const MAX_SAMPLES: f64 = 1e8;

/// The index of the next instant before the first step, which leads to the general case of `count_due`.
const BEFORE_FIRST_STEP: f64 = f64::NEG_INFINITY;

saved! {
    /// The clock of a sampled system, with the instants `start + k ts`, k = 0, 1, ...
    pub(crate) struct SampleClock {
        start: f64,
        ts: f64,
        /// Sample instants per second; multiplying by the rate is cheaper than dividing by `ts`.
        rate: f64,
        /// Index of the next instant: a whole number, exact up to 2^53, or `BEFORE_FIRST_STEP`.
        next: f64,
    }
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
    pub(crate) fn new(start: f64, ts: f64) -> Result<Self, ModelError> {
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
    pub(crate) fn count_due(&mut self, time: f64, step: f64) -> Result<u32, ModelError> {
        if self.is_one_due(time, step) {
            self.advance();
            return Ok(1);
        }
        self.count_to(time, self.samples_to(time + step))
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

    /// The general case of [`count_due`](Self::count_due), for any number of instants.
    #[inline(never)]
    fn count_to(&mut self, time: f64, end: f64) -> Result<u32, ModelError> {
        let next = self.next_from(time);
        let samples = libm::ceil(end - next).max(0.0);
        check_count(samples)?;
        self.next = next + samples;
        Ok(samples as u32)
    }

    /// The index of the next instant in a step from `time`.
    fn next_from(&self, time: f64) -> f64 {
        match self.next {
            BEFORE_FIRST_STEP => libm::ceil(self.samples_to(time)).max(0.0),
            next => next,
        }
    }

    /// Counts the instants up to `time` (up to rounding) that were not counted before.
    ///
    /// # Errors
    /// As [`count_due`](Self::count_due).
    pub(crate) fn count_due_until(&mut self, time: f64) -> Result<u32, ModelError> {
        // The time may come from `next_instant`, whose rounding error exceeds the tolerance if the time
        // is long compared to the sample time.
        let rounding = f64::EPSILON * (time.abs() + self.start.abs()) * self.rate;
        let end = libm::floor(self.samples_to(time) + 2.0 * TOLERANCE + rounding) + 1.0;
        self.count_to(time, end)
    }

    /// The sample time (s), which stays the same if the variable from which it came changes.
    #[inline]
    pub(crate) fn sample_time(&self) -> f64 {
        self.ts
    }

    /// The next instant that is not counted.
    #[inline]
    pub(crate) fn next_instant(&self) -> f64 {
        self.instant(self.next.max(0.0))
    }

    /// The instant that is the `count`-th from the end of those that were counted.
    #[inline]
    pub(crate) fn instant_before(&self, count: u32) -> f64 {
        self.instant(self.next - f64::from(count))
    }

    #[inline]
    fn instant(&self, index: f64) -> f64 {
        self.start + index * self.ts
    }

    /// The time since the start in sample times, minus the tolerance. Rounded up, it is the number of
    /// instants before `time`.
    #[inline]
    fn samples_to(&self, time: f64) -> f64 {
        (time - self.start) * self.rate - TOLERANCE
    }
}

/// Checks the number of instants in a step.
fn check_count(samples: f64) -> Result<(), ModelError> {
    match samples > MAX_SAMPLES {
        false => Ok(()),
        true => Err(ModelError::discard(format_args!(
            "the communication step contains {samples} sample instants, more than the maximum of {MAX_SAMPLES}"
        ))),
    }
}

/// The clocks of a model with several sample times, which tick in the order of time.
///
/// A model with one sample time needs no clock of its own: `#[model(sample_time = ...)]` calls its step at the
/// instants.
///
/// ```
/// use fmu_export::SampleClocks;
///
/// let mut clocks = SampleClocks::new(0.0, &[0.002, 0.001])?;
/// let mut ticks = Vec::new();
/// while let Some(tick) = clocks.next_tick(0.0, 0.003)? {
///     ticks.push((tick.time, tick.clock));
/// }
/// // At the same time, the clocks tick in the order in which they were given.
/// assert_eq!(ticks, [(0.0, 0), (0.0, 1), (0.001, 1), (0.002, 0), (0.002, 1)]);
/// # Ok::<(), fmu_export::ModelError>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SampleClocks(Vec<SampleClock>);

impl Serialize for SampleClocks {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer
            .collect_seq(self.0.iter().map(|clock| (clock.start, clock.ts, clock.rate, clock.next)))
    }
}

impl<'de> Deserialize<'de> for SampleClocks {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let clocks = Vec::deserialize(deserializer)?.into_iter();
        Ok(Self(
            clocks.map(|(start, ts, rate, next)| SampleClock { start, ts, rate, next }).collect(),
        ))
    }
}

/// A tick of one of several [`SampleClocks`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// The index of the clock.
    pub clock: usize,
    /// The instant (s).
    pub time: f64,
}

impl SampleClocks {
    /// Clocks with these sample times (s), which all tick at `start` (s) for the first time.
    ///
    /// # Errors
    /// A sample time is not a positive number.
    pub fn new(start: f64, sample_times: &[f64]) -> Result<Self, ModelError> {
        let clocks = sample_times.iter().map(|ts| SampleClock::new(start, *ts));
        clocks.collect::<Result<_, _>>().map(Self)
    }

    /// The next tick in `[time, time + step)` (up to rounding), each once. At the same time, up to rounding, the
    /// clocks tick in the order in which they were given.
    ///
    /// # Errors
    /// There are no clocks, or more than 100 million ticks are left. The step is discarded: the clocks are unchanged.
    pub fn next_tick(&mut self, time: f64, step: f64) -> Result<Option<Tick>, ModelError> {
        if self.0.is_empty() {
            return Err(ModelError::new("the clocks are not set; expected sample times"));
        }
        let (mut ticks, mut fastest, mut first) = (0.0, f64::INFINITY, f64::INFINITY);
        let end = time + step;
        let due = |clock: &SampleClock| clock.next_from(time) < clock.samples_to(end);
        for clock in &self.0 {
            ticks += libm::ceil(clock.samples_to(end) - clock.next_from(time)).max(0.0);
            fastest = fastest.min(clock.ts);
            if due(clock) {
                first = first.min(clock.instant(clock.next_from(time)));
            }
        }
        check_count(ticks)?;
        let same = first + TOLERANCE * fastest + 4.0 * f64::EPSILON * first.abs();
        for (index, clock) in self.0.iter_mut().enumerate() {
            let next = clock.next_from(time);
            let instant = clock.instant(next);
            if due(clock) && instant <= same {
                clock.next = next + 1.0;
                return Ok(Some(Tick { clock: index, time: instant }));
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clocks_tick_in_the_order_of_time_for_any_step() {
        // Sample times that are no binary fractions meet at the same times up to rounding.
        let sample_times = [0.1, 0.03, 0.01];
        for (start, steps) in [(0.0, 1), (0.0, 3), (0.0, 7), (0.0, 600), (1e6, 7), (-3.0, 60)] {
            let mut clocks = SampleClocks::new(start, &sample_times).unwrap();
            let mut ticks = Vec::new();
            for k in 0..steps {
                let [from, to] = [k, k + 1].map(|k| start + 6.0 * f64::from(k) / f64::from(steps));
                while let Some(tick) = clocks.next_tick(from, to - from).unwrap() {
                    ticks.push((libm::round((tick.time - start) * 1000.0) as i32, tick.clock));
                }
            }
            let expected = (0..6000).flat_map(|ms| {
                let clocks = [100, 30, 10].into_iter().enumerate();
                clocks.filter_map(move |(clock, ts)| (ms % ts == 0).then_some((ms, clock)))
            });
            assert!(ticks.iter().copied().eq(expected), "{start}, {steps} steps");
        }
    }

    #[test]
    fn clocks_that_are_not_set_or_tick_too_often_are_refused_and_unchanged() {
        assert!(SampleClocks::default().next_tick(0.0, 1.0).is_err());
        assert!(SampleClocks::new(0.0, &[]).unwrap().next_tick(0.0, 1.0).is_err());
        assert!(SampleClocks::new(0.0, &[0.1, 0.0]).is_err());
        let mut clocks = SampleClocks::new(0.0, &[1.0, 1e-9]).unwrap();
        let before = clocks.clone();
        assert!(clocks.next_tick(0.0, 1.0).is_err());
        assert_eq!(clocks, before);
    }

    #[test]
    fn a_late_start_drift_and_jitter_neither_lose_nor_repeat_a_sample() {
        for (start, jitter) in [(1e6, 0.0), (0.0, 1e-13)] {
            let mut clock = SampleClock::new(start, 0.001).unwrap();
            let mut time = start;
            for k in 0..20_000 {
                let h = 0.001 + if k % 2 == 0 { jitter } else { -jitter };
                assert_eq!(clock.count_due(time, h), Ok(1), "step {k}");
                time = if jitter == 0.0 { start + f64::from(k + 1) * 0.001 } else { time + h };
            }
        }
    }

    #[test]
    fn a_step_within_the_tolerance_leaves_its_instant_to_the_next() {
        let mut clock = SampleClock::new(0.0, 0.001).unwrap();
        assert_eq!(clock.count_due(0.0, 6e-14), Ok(0));
        assert_eq!(clock.count_due(6e-14, 0.001 - 6e-14), Ok(1));
        assert_eq!(clock.count_due(0.001, 0.001), Ok(1));
    }

    #[test]
    fn a_first_step_after_the_start_takes_only_its_own_instants() {
        let mut clock = SampleClock::new(0.0, 0.001).unwrap();
        assert_eq!(clock.count_due(0.5, 0.001), Ok(1));
    }

    #[test]
    fn a_sample_time_must_be_set_and_positive() {
        assert!(SampleClock::default().count_due(0.0, 0.001).is_err());
        for ts in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-320] {
            assert!(SampleClock::new(0.0, ts).is_err(), "{ts}");
        }
    }

    #[test]
    fn the_next_instant_is_due_at_its_own_time_though_it_is_rounded() {
        for start in [1e6, 1e9, 1e15, -1e12] {
            let mut clock = SampleClock::new(start, 0.001).unwrap();
            for _ in 0..1000 {
                let due = clock.count_due_until(clock.next_instant()).unwrap();
                assert!(due > 0, "start {start}: {clock:?}");
            }
        }
    }

    #[test]
    fn an_excessive_step_is_rejected_and_changes_nothing() {
        let mut clock = SampleClock::new(0.0, 0.001).unwrap();
        let before = clock;
        assert!(clock.count_due(0.0, 1e300).is_err());
        assert_eq!(clock, before);
        assert_eq!(clock.count_due(0.0, 0.001), Ok(1));
    }
}
