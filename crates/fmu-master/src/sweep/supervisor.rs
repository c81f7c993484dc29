//! Supervisor side of a sweep: hands out runs to worker processes and keeps their rows in the journal.

use std::cell::Cell;
use std::io::BufRead;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use serde::Serialize;

use super::journal::Journal;
use super::pool::{Pool, TaskOutcome, Workers};
use super::progress::SweepProgress;
use super::study::Study;
use super::worker::{SweepReply, SweepTask};
use crate::Advice;

/// The information that the coordinator of a distributed sweep needs.
#[derive(Debug, Serialize)]
pub struct Outline<'a> {
    /// Number of runs.
    pub runs: u64,
    /// The place of the system.
    pub system: &'a Path,
    /// The place of its table of inputs.
    pub input: Option<&'a Path>,
    /// The files that a worker needs: their places in its folder, in which it also looks for the FMUs by their
    /// names, and where they are.
    pub files: &'a [(PathBuf, PathBuf)],
}

impl Study {
    /// Initializes the FMUs with listed values and the ends of ranges, until they do not crash. Values that an FMU refuses
    /// are those of failed runs.
    ///
    /// # Errors
    /// The FMUs cannot be used, or crash at every value.
    fn try_corners(&self, pool: &mut Pool<'_, SweepTask>) -> Result<()> {
        let (fit, mut crash) = (Cell::new(false), None);
        let corners = self.parameters.corners();
        pool.run(
            corners.len() as u64,
            corners.into_iter().map(SweepTask::Try).take_while(|_| !fit.get()),
            |outcomes: Vec<(SweepTask, TaskOutcome<SweepReply>)>| {
                for (_, outcome) in outcomes {
                    match outcome {
                        TaskOutcome::Reply(Ok(_)) => fit.set(true),
                        TaskOutcome::Reply(Err(text)) => bail!("{}: {text}", self.sweep.display()),
                        TaskOutcome::Crash(crashed) => crash = Some(crashed),
                    }
                }
                Ok(())
            },
        )?;
        // A crash at some values is recorded with their runs.
        match crash {
            Some(text) if !fit.get() => bail!("{}: {text}", self.sweep.display()),
            _ => Ok(()),
        }
    }

    fn pool<'a>(&self, workers: &'a Workers<'a>) -> Pool<'a, SweepTask> {
        Pool::new(workers, self.plan.names())
    }

    /// Simulates runs; `keep` receives lines of runs, and why each run failed. Returns false if cancelled.
    fn execute(
        &self,
        number: u64,
        indices: impl Iterator<Item = u64>,
        pool: &mut Pool<'_, SweepTask>,
        mut keep: impl FnMut(&str, Vec<(u64, Option<String>)>) -> Result<()>,
    ) -> Result<bool> {
        let tasks = indices.map(SweepTask::Simulate);
        pool.run(number, tasks, |outcomes: Vec<(SweepTask, TaskOutcome<SweepReply>)>| {
            let (mut lines, mut runs) = (String::new(), Vec::new());
            for (SweepTask::Try(index) | SweepTask::Simulate(index), outcome) in outcomes {
                let row = match outcome {
                    TaskOutcome::Reply(Ok(Some(row))) => row,
                    TaskOutcome::Reply(Ok(None)) => continue,
                    TaskOutcome::Reply(Err(text)) => {
                        keep(&lines, runs)?;
                        bail!("{text}");
                    }
                    TaskOutcome::Crash(crash) => self.row_without_samples(index, &crash)?,
                };
                lines += &row.line;
                runs.push((index, row.failure));
            }
            keep(&lines, runs)
        })
    }

    /// Simulates some runs; `keep` receives their lines as soon as they are ready. Returns false if
    /// cancelled.
    ///
    /// # Errors
    /// There are no such runs, a run cannot be started, or `keep` fails.
    pub fn rows(
        &self,
        runs: Range<u64>,
        workers: &Workers<'_>,
        mut keep: impl FnMut(&str) -> Result<()>,
    ) -> Result<bool> {
        self.parameters.check(&runs)?;
        let number = runs.end.saturating_sub(runs.start);
        self.execute(number, runs, &mut self.pool(workers), |lines, _| keep(lines))
    }

    /// Simulates the runs that are not yet in the journal of `file`, and writes all rows to `file`.
    /// `report` is called before the first run and after one or more runs. Returns false if cancelled.
    ///
    /// # Errors
    /// The journal belongs to another sweep, a file cannot be written, or a run cannot be started.
    pub fn write(
        &self,
        file: &Path,
        workers: &Workers<'_>,
        mut report: impl FnMut(&SweepProgress),
    ) -> Result<(bool, SweepProgress)> {
        let pool = &mut self.pool(workers);
        self.try_corners(pool)?;
        let mut journal = self.journal(file)?;
        let missing = journal.missing();
        let runs = self.parameters.runs;
        let mut progress = SweepProgress {
            runs,
            before: runs - missing.iter().map(|(first, end)| end - first).sum::<u64>(),
            ..SweepProgress::default()
        };
        report(&progress);
        let pending = missing.into_iter().flat_map(|(first, end)| first..end);
        let number = runs - progress.before;
        let is_complete = self.execute(number, pending, pool, |lines, done| {
            journal.append(lines)?;
            progress.done += done.len() as u64;
            for (run, failure) in done.into_iter().filter_map(|(run, why)| Some((run, why?))) {
                progress.failed += 1;
                let first = progress.first_failure.get_or_insert((run, String::new()));
                if run <= first.0 {
                    *first = (run, failure);
                }
            }
            report(&progress);
            Ok(())
        })?;
        // They free their FMUs while the table is written.
        pool.dismiss();
        match is_complete {
            true => {
                progress.failed = 0;
                journal.finish(|cell| progress.add_row(&self.columns, cell))?;
            }
            // Nobody could resume it.
            false if self.has_functions => journal.remove()?,
            false => journal.keep()?,
        }
        Ok((is_complete, progress))
    }

    fn journal(&self, file: &Path) -> Result<Journal> {
        let (columns, runs) = (self.columns.clone(), self.parameters.runs);
        let journal = Journal::open(file, &self.fingerprint, columns, runs)?;
        if self.has_functions && journal.missing() != [(0, runs)] {
            let text = format!(
                "{}.part has rows of a sweep whose functions may have been others: delete it or give ",
                file.display()
            );
            return Err(Advice::AnotherTable.after(text));
        }
        Ok(journal)
    }

    /// Collects the rows of a sweep that other machines run: `begin` receives the outline and the ranges of
    /// the runs that are not yet in the journal of `file`, and `lines` has their rows. When they end, writes
    /// all rows to `file` and returns what came of them, unless some are missing.
    ///
    /// # Errors
    /// As [`Study::write`]; or a line is no row.
    pub fn collect(
        &self,
        file: &Path,
        workers: &Workers<'_>,
        begin: impl FnOnce(&Outline<'_>, &[(u64, u64)]) -> Result<()>,
        mut lines: impl BufRead,
    ) -> Result<Option<SweepProgress>> {
        self.try_corners(&mut self.pool(workers))?;
        let runs = self.parameters.runs;
        let (system, input, files) = (&self.files[0].0, self.input.as_deref(), &*self.files);
        let outline = Outline { runs, system, input, files };
        let mut journal = self.journal(file)?;
        begin(&outline, &journal.missing())?;
        let mut line = String::new();
        // A line without its end was torn by a kill.
        while lines.read_line(&mut line)? > 0 && line.ends_with('\n') {
            journal.append(&line)?;
            line.clear();
        }
        let mut progress = SweepProgress { runs, ..SweepProgress::default() };
        match journal.missing()[..] {
            [] => journal.finish(|cell| progress.add_row(&self.columns, cell))?,
            [(0, end)] if end == runs => return journal.remove().map(|()| None),
            _ => return journal.keep().map(|()| None),
        }
        Ok(Some(progress))
    }
}
