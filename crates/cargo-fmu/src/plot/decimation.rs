//! Rows as they arrive, in bounded memory: of many rows, the extremes of each signal in equal intervals.

/// The most intervals for which extremes are kept.
const MOST_INTERVALS: usize = 4096;
/// The most rows that are kept one by one.
const MOST_ROWS: usize = 1 << 15;
/// The fewest values of each signal, however many signals there are.
const FEWEST: usize = 512;

/// The rows of some signals. As soon as there are too many, it keeps intervals of the same number of rows: their first
/// and last time, and for each signal the smallest and the largest value, in the order in which they occur. If there are
/// too many intervals, each two become one.
///
/// A line through these values covers the same pixels as one through all rows, unless an interval is wider than a pixel.
#[derive(Debug)]
pub struct Decimation {
    /// The number of rows in an interval but the last.
    pub width: usize,
    /// The number of rows.
    pub rows: usize,
    /// How many rows and intervals there may be.
    most: [usize; 2],
    /// The number of rows in the last interval.
    filled: usize,
    /// The first and last time of each interval (s).
    times: Vec<[f64; 2]>,
    signals: Vec<Vec<[f64; 2]>>,
}

impl Decimation {
    /// No rows yet; about as many values of all signals, and times, will be kept.
    pub fn new(signals: usize, values: usize) -> Self {
        let share = values / (signals + 1);
        let most = [
            share.clamp(FEWEST, MOST_ROWS) & !1,
            (share / 2).clamp(FEWEST / 2, MOST_INTERVALS) & !1,
        ];
        let signals = vec![Vec::new(); signals];
        Self { width: 1, rows: 0, most, filled: 1, times: Vec::new(), signals }
    }

    /// Adds a row with a value of each signal, which is NaN if there is none.
    pub fn push(&mut self, time: f64, values: &[f64]) {
        let [rows, intervals] = self.most;
        let most = if self.width == 1 { rows } else { intervals };
        if self.filled == self.width && self.times.len() == most {
            while self.times.len() > intervals / 2 {
                self.double();
            }
        }
        self.rows += 1;
        let signals = self.signals.iter_mut().zip(values);
        match self.times.last_mut() {
            Some(last) if self.filled < self.width => {
                last[1] = time;
                self.filled += 1;
                for (signal, value) in signals {
                    if let Some(last) = signal.last_mut() {
                        *last = joined(*last, [*value; 2]);
                    }
                }
            }
            _ => {
                self.times.push([time; 2]);
                self.filled = 1;
                signals.for_each(|(signal, value)| signal.push([*value; 2]));
            }
        }
    }

    /// Makes one interval of each two.
    fn double(&mut self) {
        if self.times.len().is_multiple_of(2) {
            self.filled += self.width;
        }
        self.width *= 2;
        let times = self.times.chunks(2);
        self.times = times.map(|pair| [pair[0][0], pair[pair.len() - 1][1]]).collect();
        for signal in &mut self.signals {
            let pairs = signal.chunks(2);
            *signal = pairs.map(|pair| joined(pair[0], pair[pair.len() - 1])).collect();
        }
    }

    /// The times that are kept (s): of all rows, or two of each interval.
    pub fn times(&self) -> Vec<f64> {
        self.kept(&self.times)
    }

    /// The values of each signal at these times.
    pub fn signals(&self) -> impl Iterator<Item = Vec<f64>> {
        self.signals.iter().map(|signal| self.kept(signal))
    }

    fn kept(&self, pairs: &[[f64; 2]]) -> Vec<f64> {
        let kept = if self.width == 1 { 1 } else { 2 };
        pairs.iter().flat_map(|pair| &pair[..kept]).copied().collect()
    }
}

/// The smallest and the largest value of two intervals, in the order in which they occur; NaN if all values are.
fn joined(first: [f64; 2], second: [f64; 2]) -> [f64; 2] {
    let all = [first[0], first[1], second[0], second[1]];
    let mut known = (0..4).filter(|index| !all[*index].is_nan());
    let Some(start) = known.next() else { return first };
    let (mut least, mut most) = (start, start);
    for index in known {
        if all[index] < all[least] {
            least = index;
        }
        if all[index] > all[most] {
            most = index;
        }
    }
    [all[least.min(most)], all[least.max(most)]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decimated(rows: usize, signals: &[fn(usize) -> f64]) -> Decimation {
        let mut decimation = Decimation::new(signals.len(), 1);
        for row in 0..rows {
            let values = Vec::from_iter(signals.iter().map(|signal| signal(row)));
            decimation.push(row as f64, &values);
        }
        decimation
    }

    #[test]
    fn few_rows_stay_as_they_are() {
        let decimation = decimated(FEWEST, &[|row| row as f64 * 0.5]);
        assert_eq!((decimation.width, decimation.rows), (1, FEWEST));
        let rows = Vec::from_iter((0..FEWEST).map(|row| row as f64));
        assert_eq!(decimation.times(), rows);
        let values = decimation.signals().next().unwrap();
        assert_eq!(values, Vec::from_iter(rows.iter().map(|row| row * 0.5)));
    }

    #[test]
    fn intervals_cover_all_rows_and_a_rising_signal_keeps_its_values_at_their_times() {
        for rows in [FEWEST + 1, 1000, 1023, 1024, 1025, 99_999, 1 << 17] {
            let decimation = decimated(rows, &[|row| row as f64]);
            let (times, width) = (decimation.times(), decimation.width);
            assert!(width.is_power_of_two() && width > 1);
            let intervals = rows.div_ceil(width);
            assert!(intervals <= FEWEST / 2 && times.len() == 2 * intervals, "{rows} {width}");
            for (interval, ends) in times.chunks(2).enumerate() {
                let last = ((interval + 1) * width).min(rows) - 1;
                assert_eq!(ends, [(interval * width) as f64, last as f64], "{rows}");
            }
            assert_eq!(decimation.signals().next().unwrap(), times);
        }
    }

    #[test]
    fn no_extreme_is_lost_and_extremes_stay_in_their_order() {
        const SPIKE: usize = 54_321;
        let spike = |row| if row == SPIKE { 7.0 } else { 0.0 };
        let wave = |row| (row as f64 * 0.01).sin();
        let saw = |row| -((row % 3) as f64);
        let gap = |row| if row < 50_000 { f64::NAN } else { 1.0 };
        let decimation = decimated(100_000, &[spike, wave, saw, gap]);
        let width = decimation.width;
        let [spikes, waves, saws, gaps] =
            Vec::from_iter(decimation.signals()).try_into().expect("four signals");
        let at = SPIKE / width * 2;
        for (index, value) in spikes.iter().enumerate() {
            let expected = if index == at + 1 { 7.0 } else { 0.0 };
            assert_eq!(*value, expected);
        }
        for (interval, pair) in waves.chunks(2).enumerate() {
            let rows = interval * width..((interval + 1) * width).min(100_000);
            let values = Vec::from_iter(rows.map(wave));
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let place = |value| values.iter().position(|other| *other == value);
            let expected = if place(least) < place(most) { [least, most] } else { [most, least] };
            assert_eq!(pair, expected);
        }
        assert!(saws.chunks(2).all(|pair| pair == [0.0, -2.0] || pair == [-2.0, 0.0]));
        let first = gaps.iter().position(|value| !value.is_nan()).unwrap();
        assert_eq!(first, 50_000 / width * 2);
        assert!(gaps[first..].iter().all(|value| *value == 1.0));
    }
}
