//! When time-based clocks tick (FMI 3.0.2, section 2.2.9.2).

use fmu_host::IntervalFraction;
use serde::{Deserialize, Serialize};

/// A time (s), as a number or as a fraction, any multiple of which is rounded only once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) enum Span {
    Decimal(f64),
    Fraction { counter: u64, resolution: u64 },
}

impl Span {
    pub(crate) const ZERO: Self = Self::Decimal(0.0);

    pub(crate) fn seconds(self) -> f64 {
        match self {
            Self::Decimal(seconds) => seconds,
            Self::Fraction { counter, resolution } => counter as f64 / resolution as f64,
        }
    }

    /// The sum of this time and a number of others (s).
    fn plus(self, count: u64, other: Self) -> f64 {
        match (self, other) {
            (
                Self::Fraction { counter: first, resolution },
                Self::Fraction { counter, resolution: same },
            ) if resolution == same => {
                let sum = u128::from(first) + u128::from(count) * u128::from(counter);
                sum as f64 / resolution as f64
            }
            (first, Self::Fraction { counter, resolution }) => {
                let all = u128::from(count) * u128::from(counter);
                first.seconds() + all as f64 / resolution as f64
            }
            (first, Self::Decimal(seconds)) => first.seconds() + count as f64 * seconds,
        }
    }
}

impl From<IntervalFraction> for Span {
    fn from(IntervalFraction { counter, resolution }: IntervalFraction) -> Self {
        Self::Fraction { counter, resolution }
    }
}

/// The ticks of a clock that are to come.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) enum Ticks {
    /// At equal intervals, which do not add up rounding errors: the ticks are at `origin` plus `shift` plus multiples of
    /// the interval, of which the next one has this number.
    Periodic { origin: f64, shift: Span, interval: Span, number: u64 },
    /// At this time (s), if it is known.
    Next(Option<f64>),
}

impl Ticks {
    /// The ticks of a periodic clock from a start time (s).
    pub(crate) fn periodic(start: f64, shift: Span, interval: Span) -> Self {
        Self::Periodic { origin: start, shift, interval, number: 0 }
    }

    /// The time of the next one (s), if it is known.
    pub(crate) fn next(&self) -> Option<f64> {
        match *self {
            Self::Periodic { origin, shift, interval, number } => {
                Some(origin + shift.plus(number, interval))
            }
            Self::Next(time) => time,
        }
    }

    /// Goes on to the tick after the next one, if that is known already.
    pub(crate) fn tick(&mut self) {
        match self {
            Self::Periodic { number, .. } => *number += 1,
            Self::Next(time) => *time = None,
        }
    }

    /// Has the clock tick next after an interval from an event (s), and if it is periodic, then again and again.
    pub(crate) fn restart(&mut self, event: f64, new: Span) {
        match self {
            Self::Periodic { origin, shift, interval, number } => {
                (*origin, *shift, *interval, *number) = (event, Span::ZERO, new, 1);
            }
            Self::Next(time) => *time = Some(event + new.seconds()),
        }
    }
}

/// How far equal times of a communication step (s) may be apart.
pub(crate) fn rounding(time: f64, step: f64) -> f64 {
    1e-9 * step + 16.0 * f64::EPSILON * time.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The times of the first ticks.
    fn times(mut ticks: Ticks, count: usize) -> Vec<f64> {
        let next = || {
            let next = ticks.next();
            ticks.tick();
            next
        };
        Vec::from_iter(std::iter::from_fn(next).take(count))
    }

    #[test]
    fn periodic_ticks_do_not_drift() {
        let decimal = Ticks::periodic(1.0, Span::Decimal(0.05), Span::Decimal(0.1));
        for (number, time) in times(decimal, 1_000_001).into_iter().enumerate() {
            let exact = 1.05 + number as f64 / 10.0;
            assert!((time - exact).abs() <= 2.0 * f64::EPSILON * exact, "{number}: {time}");
        }
        // A third of a second has no decimal.
        let span = |counter| Span::Fraction { counter, resolution: 3 };
        let ticks = times(Ticks::periodic(0.0, span(2), span(1)), 1_000_000);
        assert_eq!(ticks[..2], [2.0 / 3.0, 1.0]);
        assert_eq!(ticks[999_997], 333_333.0);
        // Fractions of different resolutions.
        let shift = Span::Fraction { counter: 1, resolution: 2 };
        assert_eq!(times(Ticks::periodic(0.0, shift, span(3)), 3), [0.5, 1.5, 2.5]);
    }

    #[test]
    fn the_largest_counters_do_not_overflow() {
        let (counter, resolution) = (u64::MAX, u64::MAX);
        let second = Span::Fraction { counter, resolution };
        assert_eq!(times(Ticks::periodic(0.0, second, second), 3), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn a_new_interval_begins_at_the_event() {
        let mut ticks = Ticks::periodic(0.0, Span::ZERO, Span::Decimal(1.0));
        ticks.tick();
        ticks.restart(0.25, Span::Decimal(0.5));
        assert_eq!(times(ticks, 3), [0.75, 1.25, 1.75]);
    }

    #[test]
    fn an_aperiodic_clock_ticks_once_for_each_interval() {
        let mut ticks = Ticks::Next(None);
        assert_eq!(ticks.next(), None);
        ticks.restart(2.0, Span::Decimal(0.5));
        assert_eq!(times(ticks, 2), [2.5]);
    }
}
