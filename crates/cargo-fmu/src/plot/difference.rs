//! The difference of two runs, at the times of both.

use fmu_master::table::rounding;

use super::decimation::Decimation;

/// A time (s), and a value of each signal; NaN where there is none.
pub type Row = (f64, Vec<f64>);

/// A signal that both runs have.
#[derive(Debug)]
pub struct Pair {
    /// Its index in the first and in the known run.
    pub signals: [usize; 2],
    /// Whether it keeps its value until the next row; else it is interpolated.
    pub is_held: bool,
    /// The difference with the largest magnitude, and its time (s).
    pub largest: Option<(f64, f64)>,
}

/// A run minus a known one, while the rows of the first one arrive, and those of the known one are read.
#[derive(Debug)]
pub struct Difference {
    pub pairs: Vec<Pair>,
    pub decimation: Decimation,
    /// The row that arrived last.
    before: Option<Row>,
    known: KnownRows,
}

/// The rows of the known run around a time.
#[derive(Debug, Default)]
struct KnownRows {
    /// The first time (s), once it is read.
    start: Option<f64>,
    /// The last row up to the time, and the one after it.
    passed: Option<Row>,
    next: Option<Row>,
}

impl Difference {
    /// The difference of these signals, of which about as many values are kept.
    pub fn new(pairs: Vec<Pair>, values: usize) -> Self {
        let decimation = Decimation::new(pairs.len(), values);
        Self { pairs, decimation, before: None, known: KnownRows::default() }
    }

    /// Adds a row of the first run. `rows` are those of the known run that were not taken yet.
    pub fn push(&mut self, rows: &mut impl Iterator<Item = Row>, time: f64, values: &[f64]) {
        if let Some((before, earlier)) = self.before.take() {
            // Of several rows at one time, the last counts, as it has the values after an event.
            let same = self.known.rounding(rows, time);
            if time - before > same {
                self.add(rows, before, &earlier);
                while let Some((between, _)) = self.known.next
                    && between < time - same
                {
                    let part = (between - before) / (time - before);
                    let mut row = earlier.clone();
                    for Pair { signals: [first, _], is_held, .. } in &self.pairs {
                        if !is_held {
                            row[*first] += part * (values[*first] - earlier[*first]);
                        }
                    }
                    self.add(rows, between, &row);
                }
            }
        }
        self.before = Some((time, values.to_vec()));
    }

    /// Adds the last row.
    pub fn finish(&mut self, rows: &mut impl Iterator<Item = Row>) {
        if let Some((time, values)) = self.before.take() {
            self.add(rows, time, &values);
        }
    }

    /// Adds the difference at a time, unless one run does not have it.
    fn add(&mut self, rows: &mut impl Iterator<Item = Row>, time: f64, values: &[f64]) {
        let same = self.known.rounding(rows, time);
        self.known.pass(rows, time + same);
        let Some(passed) = &self.known.passed else { return };
        if self.known.next.is_none() && passed.0 < time - same {
            return;
        }
        let next = self.known.next.as_ref().filter(|_| passed.0 < time - same);
        let row = Vec::from_iter(self.pairs.iter_mut().map(|pair| {
            let [first, second] = pair.signals;
            let other = match next.filter(|_| !pair.is_held) {
                Some((after, next)) => {
                    let part = (time - passed.0) / (after - passed.0);
                    passed.1[second] + part * (next[second] - passed.1[second])
                }
                None => passed.1[second],
            };
            let difference = values[first] - other;
            let largest = pair.largest.map_or(-1.0, |(largest, _)| largest.abs());
            if difference.abs() > largest && difference.is_finite() {
                pair.largest = Some((difference, time));
            }
            difference
        }));
        self.decimation.push(time, &row);
    }
}

impl KnownRows {
    /// How far apart times are that are the same but for rounding (s).
    fn rounding(&mut self, rows: &mut impl Iterator<Item = Row>, time: f64) -> f64 {
        if self.start.is_none() {
            self.next = rows.next();
            self.start = Some(self.next.as_ref().map_or(time, |(start, _)| *start));
        }
        rounding(time, self.start.unwrap_or(time))
    }

    /// Takes the rows up to a time.
    fn pass(&mut self, rows: &mut impl Iterator<Item = Row>, time: f64) {
        while let Some(row) = self.next.take_if(|(next, _)| *next <= time) {
            self.passed = Some(row);
            self.next = rows.next();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn difference(
        [times, values]: [&[f64]; 2],
        [known, other]: [&[f64]; 2],
        is_held: bool,
    ) -> Difference {
        let rows = known.iter().zip(other).map(|(time, value)| (*time, vec![*value]));
        let mut rows = rows.collect::<Vec<_>>().into_iter();
        let pair = Pair { signals: [0, 0], is_held, largest: None };
        let mut difference = Difference::new(vec![pair], 1);
        for (time, value) in times.iter().zip(values) {
            difference.push(&mut rows, *time, &[*value]);
        }
        difference.finish(&mut rows);
        difference
    }

    #[test]
    fn a_difference_is_at_the_times_of_both_runs_and_interpolates_or_holds() {
        let (first, second) =
            ([&[0.0, 1.0, 2.0][..], &[0.0, 1.0, 2.0]], [&[0.0, 0.5, 2.0][..], &[0.0, 5.0, 2.0]]);
        for (is_held, expected, largest) in [
            (false, [0.0, -4.5, -3.0, 0.0], (-4.5, 0.5)),
            (true, [0.0, -5.0, -4.0, 0.0], (-5.0, 0.5)),
        ] {
            let found = difference(first, second, is_held);
            assert_eq!(found.decimation.times(), [0.0, 0.5, 1.0, 2.0]);
            assert_eq!(found.decimation.signals().next().unwrap(), expected);
            assert_eq!(found.pairs[0].largest, Some(largest));
        }
    }

    #[test]
    fn of_rows_at_one_time_the_last_counts_and_times_of_one_run_only_are_left_out() {
        let steps = [&[0.0, 1.0, 1.0, 2.0, 3.0][..], &[0.0, 0.0, 1.0, 1.0, 9.0]];
        let later = [&[0.5, 1.0 + 1e-13, 2.0][..], &[0.0, 1.0, 1.0]];
        let found = difference(steps, later, true);
        assert_eq!(found.decimation.times(), [0.5, 1.0, 2.0]);
        assert_eq!(found.decimation.signals().next().unwrap(), [0.0; 3]);
        assert_eq!(difference(steps, [&[], &[]], true).pairs[0].largest, None);
    }
}
