//! The progress of a sweep, and what has come of its runs: failures and the best run.

use fmu_description::Value;

use super::row::{FAILURE, INDEX};
use crate::table::{Cell, Column};

/// Progress of [`Study::write`](super::Study::write).
#[derive(Debug, Clone, Default)]
pub struct SweepProgress {
    /// Total number of runs.
    pub runs: u64,
    /// Number of runs that were already in the journal.
    pub before: u64,
    /// Number of runs done since.
    pub done: u64,
    /// The number of runs since then that failed; once all runs are done, of all.
    pub failed: u64,
    /// The first of these, and why.
    pub first_failure: Option<(u64, String)>,
    /// Once all runs are done: the smallest integral of the absolute error of a run that did not diverge, and
    /// this run with its parameters.
    pub best: Option<(f64, String)>,
    /// Once all runs are done: the number of those that diverged or failed.
    pub diverged: u64,
    /// The first of these with its parameters.
    pub first_diverged: Option<String>,
}

impl SweepProgress {
    /// Takes a row of the table into account, whose cells are read when they are needed.
    pub(super) fn add_row(&mut self, columns: &[Column], cell: &dyn Fn(usize) -> Cell) {
        let value = |name| cell(columns.iter().position(|column| column.name == name)?);
        let run = || {
            let parameters = columns.iter().take_while(|column| column.name != "iae");
            let named = parameters.enumerate().filter_map(|(place, column)| {
                let value = cell(place)?;
                Some(match column.name.as_str() {
                    INDEX => format!("run {value}"),
                    name => format!("{name} = {value}"),
                })
            });
            Vec::from_iter(named).join(", ")
        };
        if let Some(Value::String(why)) = value(FAILURE)
            && let Some(Value::Int64(index)) = value(INDEX)
        {
            let index = index as u64;
            self.failed += 1;
            if self.first_failure.as_ref().is_none_or(|(first, _)| index < *first) {
                self.first_failure = Some((index, why));
            }
        }
        if let Some(Value::Boolean(true)) = value("diverged") {
            self.diverged += 1;
            self.first_diverged.get_or_insert_with(run);
        } else if let Some(Value::Float64(iae)) = value("iae")
            && self.best.as_ref().is_none_or(|(best, _)| iae < *best)
        {
            self.best = Some((iae, run()));
        }
    }
}

#[cfg(test)]
mod tests {
    use fmu_description::Type;

    use super::*;

    #[test]
    fn the_best_run_is_the_one_with_the_smallest_error_of_those_that_did_not_diverge() {
        let columns = [
            Column::new("index", "", Type::UInt64),
            Column::new("a.k", "1", Type::Float64),
            Column::new("iae", "1", Type::Float64),
            Column::new("diverged", "", Type::Boolean),
        ];
        let mut progress = SweepProgress::default();
        let runs = [
            (1.0, 3.0, false),
            (2.0, 0.5, true),
            (4.0, f64::NAN, true),
            (8.0, 2.0, false),
            (9.0, 2.5, false),
        ];
        for (index, (k, iae, diverged)) in (0..).zip(runs) {
            let row = [
                Value::UInt64(index),
                Value::Float64(k),
                Value::Float64(iae),
                Value::Boolean(diverged),
            ];
            progress.add_row(&columns, &|place| Some(row[place].clone()));
        }
        assert_eq!(progress.best, Some((2.0, "run 3, a.k = 8.0".to_owned())));
        assert_eq!(progress.diverged, 2);
        assert_eq!(progress.first_diverged.as_deref(), Some("run 1, a.k = 2.0"));
    }
}
