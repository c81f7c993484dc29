//! Sample instants: when a sampled controller acts, independent of the host's communication steps.

use fmu_description::{Number, StateError, StateReader, StateWriter};

use crate::error::{ModelError, ensure};
use crate::saved::{Saved, saved};

/// An instant within this fraction of the sample time of a communication point counts as lying on
/// it: hosts compute time in floating point, so times are never compared for equality.
const TOLERANCE: f64 = 1e-6;

/// Maximum number of samples in one communication step; more would take minutes to compute.
const MAX_SAMPLES: f64 = 1e8;

/// The index of the next instant before the first step, which leads to the general case of `count_due`.
const BEFORE_FIRST_STEP: f64 = f64::NEG_INFINITY;

/// Until when instants are due.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Due {
    /// Before the end of a step (s), to which its last instant does not belong.
    Before(f64),
    /// Up to a time of event mode (s), which belongs to them.
    Until(f64),
}

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
        Self::of_rate("", start, ts)
    }

    /// As [`new`](Self::new), for a rate with a name.
    fn of_rate(name: &str, start: f64, ts: f64) -> Result<Self, ModelError> {
        let rate = 1.0 / ts;
        if !(ts > 0.0 && ts.is_finite() && rate.is_finite()) {
            let of = if name.is_empty() { "" } else { " of " };
            return Err(ModelError::new(format_args!(
                "the sample time{of}{name} is {} s; expected a positive number",
                Number(ts)
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

    /// Counts the instants up to the one at a time (up to rounding), which the host chooses. Returns whether instants
    /// before it were not counted.
    ///
    /// # Errors
    /// It is not the time of an instant, or the instant was counted. The clock is unchanged.
    pub(crate) fn tick_at(&mut self, time: f64) -> Result<bool, ModelError> {
        let (next, Self { start, ts, .. }) = (self.next.max(0.0), *self);
        let instant = libm::round((time - start) * self.rate);
        let rounding = 4.0 * f64::EPSILON * (time.abs() + start.abs());
        let is_instant = (time - self.instant(instant)).abs() <= TOLERANCE * ts + rounding;
        ensure!(
            is_instant && instant >= next,
            "the clock cannot tick at {:?} s; expected {:?} s, or later by a multiple of its interval {:?} s",
            Number(time),
            Number(self.instant(next)),
            Number(ts)
        );
        self.next = instant + 1.0;
        Ok(instant > next)
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
        self.count_to(time, self.end(Due::Until(time)))
    }

    /// The instants that are due have smaller indices.
    fn end(&self, due: Due) -> f64 {
        match due {
            Due::Before(time) => self.samples_to(time),
            Due::Until(time) => {
                // The time may come from `next_instant`, whose rounding error exceeds the tolerance if the time
                // is long compared to the sample time.
                let rounding = f64::EPSILON * (time.abs() + self.start.abs()) * self.rate;
                libm::floor(self.samples_to(time) + 2.0 * TOLERANCE + rounding) + 1.0
            }
        }
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
            "the communication step contains {} sample instants, more than the maximum of {}",
            Number(samples),
            Number(MAX_SAMPLES)
        ))),
    }
}

/// The clocks of a model with several rates, in the order in which these are declared.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RateClocks(Vec<SampleClock>);

/// A sample instant of one of several rates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tick {
    /// The index of the rate.
    pub(crate) rate: usize,
    /// The instant (s).
    pub(crate) time: f64,
    /// The sample time (s).
    pub(crate) sample_time: f64,
    /// The index of the instant.
    instant: f64,
}

impl RateClocks {
    /// Clocks that are not set, for a model with so many rates.
    pub(crate) fn unset(rates: usize) -> Self {
        Self(vec![SampleClock::UNSET; rates])
    }

    /// Clocks for rates, each with its name and sample time (s), which all tick at `start` (s) for the first time.
    ///
    /// # Errors
    /// A sample time is not a positive number.
    pub(crate) fn new(start: f64, rates: &[(&str, f64)]) -> Result<Self, ModelError> {
        let clocks = rates.iter().map(|(name, ts)| SampleClock::of_rate(name, start, *ts));
        clocks.collect::<Result<_, _>>().map(Self)
    }

    /// Checks the number of ticks that are due in a step from `time`.
    ///
    /// # Errors
    /// There are more than 100 million. The step is discarded.
    pub(crate) fn check_count(&self, time: f64, due: Due) -> Result<(), ModelError> {
        let ticks = |clock: &SampleClock| libm::ceil(clock.end(due) - clock.next_from(time));
        check_count(self.0.iter().map(|clock| ticks(clock).max(0.0)).sum())
    }

    /// The next tick that is due in a step from `time`. At the same time, up to rounding, it is the one of the rate
    /// that is declared first.
    pub(crate) fn next_tick(&self, time: f64, due: Due) -> Option<Tick> {
        let tick = |(rate, clock): (usize, &SampleClock)| {
            let instant = clock.next_from(time);
            let (time, sample_time) = (clock.instant(instant), clock.ts);
            (instant < clock.end(due)).then_some(Tick { rate, time, sample_time, instant })
        };
        let mut ticks = self.0.iter().enumerate().filter_map(tick);
        let first = ticks.clone().map(|tick| tick.time).fold(f64::INFINITY, f64::min);
        let fastest = self.0.iter().map(|clock| clock.ts).fold(f64::INFINITY, f64::min);
        let same = first + TOLERANCE * fastest + 4.0 * f64::EPSILON * first.abs();
        ticks.find(|tick| tick.time <= same)
    }

    /// The clock of a rate.
    pub(crate) fn at(&mut self, rate: usize) -> &mut SampleClock {
        &mut self.0[rate]
    }

    /// Counts a tick, which the model has taken.
    pub(crate) fn advance(&mut self, tick: Tick) {
        self.0[tick.rate].next = tick.instant + 1.0;
    }

    /// The next instant that is not counted; infinite if there are no clocks.
    pub(crate) fn next_instant(&self) -> f64 {
        self.0.iter().map(SampleClock::next_instant).fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn save(&self, to: &mut StateWriter) -> Result<(), StateError> {
        self.0.iter().try_for_each(|clock| clock.save(to))
    }

    /// The clocks of a model with so many rates.
    pub(crate) fn load(from: &mut StateReader<'_>, rates: usize) -> Result<Self, StateError> {
        (0..rates).map(|_| SampleClock::load(from)).collect::<Result<_, _>>().map(Self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts and returns the ticks that are due: times in ms after the start, and rates.
    fn ticks(clocks: &mut RateClocks, start: f64, from: f64, due: Due) -> Vec<(i32, usize)> {
        let mut ticks = Vec::new();
        while let Some(tick) = clocks.next_tick(from, due) {
            clocks.advance(tick);
            ticks.push((libm::round((tick.time - start) * 1000.0) as i32, tick.rate));
        }
        ticks
    }

    #[test]
    fn rates_tick_in_the_order_of_time_for_any_step() {
        // Sample times that are no binary fractions meet at the same times up to rounding.
        let rates = [("slow", 0.1), ("middle", 0.03), ("fast", 0.01)];
        let expected = (0..6000).flat_map(|ms| {
            let rates = [100, 30, 10].into_iter().enumerate();
            rates.filter_map(move |(rate, ts)| (ms % ts == 0).then_some((ms, rate)))
        });
        for (start, steps) in [(0.0, 1), (0.0, 3), (0.0, 7), (0.0, 600), (1e6, 7), (-3.0, 60)] {
            let mut clocks = RateClocks::new(start, &rates).unwrap();
            let mut found = Vec::new();
            for k in 0..steps {
                let [from, to] = [k, k + 1].map(|k| start + 6.0 * f64::from(k) / f64::from(steps));
                found.extend(ticks(&mut clocks, start, from, Due::Before(from + (to - from))));
            }
            assert!(found.iter().copied().eq(expected.clone()), "{start}, {steps} steps");
        }
        // As events, of which each is the next instant.
        for start in [0.0, 1e6, -3.0] {
            let mut clocks = RateClocks::new(start, &rates).unwrap();
            let mut found = Vec::new();
            while clocks.next_instant() < start + 5.999 {
                let now = clocks.next_instant();
                let due = ticks(&mut clocks, start, now, Due::Until(now));
                assert!(!due.is_empty());
                found.extend(due);
            }
            assert!(found.iter().copied().eq(expected.clone()), "{start}");
        }
    }

    #[test]
    fn rates_that_tick_too_often_or_have_no_sample_time_are_refused() {
        let error = RateClocks::new(0.0, &[("slow", 0.1), ("fast", 0.0)]).unwrap_err();
        assert_eq!(error.reason(), "the sample time of fast is 0 s; expected a positive number");
        let clocks = RateClocks::new(0.0, &[("slow", 1.0), ("fast", 1e-9)]).unwrap();
        assert!(clocks.check_count(0.0, Due::Before(1.0)).is_err());
        assert!(clocks.check_count(0.0, Due::Before(1e-3)).is_ok());
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
