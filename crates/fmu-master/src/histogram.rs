//! A histogram of durations whose size does not grow: percentiles of any number of durations, with an error of at most 1/32.

use std::time::Duration;

/// A duration is counted by its leading bits: all of a short one, of a longer one the highest and the next five.
const BITS: u32 = 5;
const COUNTERS: usize = (64 - BITS as usize + 1) << BITS;

/// Durations, from 1 ns on.
pub(crate) struct Histogram {
    counts: Box<[u64; COUNTERS]>,
    total: u64,
}

impl Histogram {
    pub(crate) fn new() -> Self {
        Self { counts: Box::new([0; COUNTERS]), total: 0 }
    }

    /// Counts a duration. Allocates nothing.
    pub(crate) fn add(&mut self, duration: Duration) {
        let nanoseconds = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        self.counts[place(nanoseconds)] += 1;
        self.total += 1;
    }

    /// The duration that this part of all durations, 0 to 1, does not exceed; `None` if there is none.
    pub(crate) fn percentile(&self, part: f64) -> Option<Duration> {
        let rank = ((part * self.total as f64).ceil() as u64).max(1);
        let mut counted = 0;
        let mut places = self.counts.iter().zip(0..);
        let (_, place) = places.find(|(count, _)| {
            counted += **count;
            counted >= rank
        })?;
        Some(Duration::from_nanos(largest(place)))
    }
}

/// The counter of a duration.
fn place(nanoseconds: u64) -> usize {
    let shift = nanoseconds.checked_ilog2().unwrap_or(0).saturating_sub(BITS);
    ((shift as usize) << BITS) + (nanoseconds >> shift) as usize
}

/// The longest duration of a counter (ns).
fn largest(place: usize) -> u64 {
    let shift = (place >> BITS).saturating_sub(1) as u32;
    let leading = (place - ((shift as usize) << BITS)) as u64;
    (leading << shift) + ((1 << shift) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_duration_has_a_counter_whose_longest_is_at_most_a_32nd_longer() {
        let mut before = 0;
        for exponent in 0..64 {
            for offset in [0, 1, 2, 3, 5, 7].map(|part| (1_u64 << exponent) / 8 * part) {
                let nanoseconds = (1 << exponent) + offset;
                let (place, largest) = (place(nanoseconds), largest(place(nanoseconds)));
                assert!(place < COUNTERS && place >= before, "{nanoseconds}");
                assert!(largest >= nanoseconds && largest - nanoseconds <= nanoseconds / 32);
                before = place;
            }
        }
        assert_eq!([0, 1, 31, 32, 63].map(place), [0, 1, 31, 32, 63]);
        assert_eq!((place(u64::MAX), largest(COUNTERS - 1)), (COUNTERS - 1, u64::MAX));
    }

    #[test]
    fn percentiles_are_the_ranks_of_sorted_durations() {
        let mut histogram = Histogram::new();
        assert_eq!(histogram.percentile(0.5), None);
        // 1 to 1000 us, in another order.
        (0..1000).for_each(|k| histogram.add(Duration::from_micros((k * 77) % 1000 + 1)));
        for (part, expected) in
            [(0.0, 1.0), (0.5, 500.0), (0.99, 990.0), (0.999, 999.0), (1.0, 1000.0)]
        {
            let found = histogram.percentile(part).unwrap().as_secs_f64() * 1e6;
            assert!(found >= expected && found <= expected * (1.0 + 1.0 / 32.0), "{part}: {found}");
        }
    }
}
