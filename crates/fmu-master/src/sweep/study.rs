//! A study: a sweep file applied to its system, run by run.

use std::cell;
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::io::BufRead;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use fmu_description::hash::checksum;
use fmu_description::{Type, Value};
use fmu_worker::{Record, Service};
use serde::{Deserialize, Serialize};

use super::journal::Journal;
use super::metrics::{Criteria, LoopSample, Metrics, MetricsAccumulator};
use super::parameters::{Parameter, Parameters};
use super::pool::{Pool, TaskOutcome, Workers};
use crate::table::{self, Cell, Column};
use crate::{
    Advice, Description, Literal, Messages, Order, Place, Plan, Row, RunError, Sandbox, Simulation,
    StartValue, SystemOrigin, locate,
};

/// The contents of a sweep file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SweepFile {
    /// The system file, relative to the folder of the sweep file.
    system: PathBuf,
    /// Times and order that override the system's.
    start: Option<f64>,
    stop: Option<f64>,
    step: Option<f64>,
    order: Option<Order>,
    /// Start values of all runs, which override the system's.
    #[serde(default)]
    set: BTreeMap<String, Literal>,
    #[serde(default)]
    seed: u64,
    #[serde(default = "one")]
    draws: u64,
    #[serde(default)]
    parameter: Vec<Parameter>,
    signals: LoopSignals,
    #[serde(default)]
    metrics: Criteria,
}

fn one() -> u64 {
    1
}

/// The variables from which the metrics are computed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LoopSignals {
    reference: String,
    output: String,
    error: String,
    control: String,
}

/// A sweep that is ready to run.
pub struct Study {
    /// The sweep file.
    sweep: PathBuf,
    plan: Plan,
    /// The files that it depends on, and their places for a worker elsewhere.
    files: Vec<(PathBuf, PathBuf)>,
    input: Option<PathBuf>,
    /// Unpacked packages, from which a worker elsewhere gets the FMUs.
    _package: Option<Arc<SystemOrigin>>,
    parameters: Parameters,
    /// The index of the run, its parameters and metrics, and why it failed.
    columns: Vec<Column>,
    fingerprint: String,
    set: Vec<StartValue>,
    /// The places of reference, output, error and control in a row of the system.
    signals: [Place; 4],
    metrics: Criteria,
}

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

/// Progress of [`Study::write`].
#[derive(Debug, Clone, Default)]
pub struct SweepProgress {
    /// Total number of runs.
    pub runs: u64,
    /// Number of runs that were already in the journal.
    pub before: u64,
    /// Number of runs done since.
    pub done: u64,
    /// Once all runs are done: the number of those that failed.
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
    /// Compares a row of the table, whose cells are read when they are asked for, with the best so far.
    fn see(&mut self, columns: &[Column], cell: &dyn Fn(usize) -> Cell) {
        let value = |name| cell(columns.iter().position(|column| column.name == name)?);
        let run = || {
            let parameters = columns.iter().take_while(|column| column.name != "iae");
            let named = parameters.enumerate().filter_map(|(place, column)| {
                let value = cell(place)?;
                Some(match column.name.as_str() {
                    "index" => format!("run {value}"),
                    name => format!("{name} = {value}"),
                })
            });
            Vec::from_iter(named).join(", ")
        };
        if let Some(Value::String(why)) = value("failure")
            && let Some(Value::Int64(index)) = value("index")
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

/// What a worker is asked to do.
#[derive(Clone, Copy, Serialize, Deserialize)]
enum Task {
    /// To initialize a run without simulating it.
    Try(u64),
    /// To simulate a run.
    Simulate(u64),
}

/// The answer of a worker: the outcome of a run unless it was only tried, or why it cannot be started.
type Reply = Result<Option<FinishedRun>, String>;

/// The line of a run, and why it failed with the words of the FMU.
#[derive(Serialize, Deserialize)]
struct FinishedRun {
    line: String,
    failure: Option<String>,
}

impl Study {
    /// Reads a sweep file and loads the FMUs of its system. `system`, `fmus` and `input` override the system
    /// file, the folder of its FMUs and its table of inputs.
    ///
    /// # Errors
    /// A file cannot be read, or its contents do not fit.
    pub fn open(
        sweep: &Path,
        system: Option<&Path>,
        fmus: Option<&Path>,
        input: Option<&Path>,
        sandbox: Sandbox,
    ) -> Result<Self> {
        let text = fs::read_to_string(sweep)
            .with_context(|| format!("cannot read {}", sweep.display()))?;
        let file: SweepFile = toml::from_str(&text).map_err(|error| {
            let text = format!("{}: {error}", sweep.display());
            match error.message().contains("unknown field `component`") {
                true => Advice::Simulate.after(format!("{text}it is a system, expected ")),
                false => anyhow!("{text}"),
            }
        })?;
        Self::load(sweep, &text, file, system, fmus, input, sandbox)
            .map_err(|error| locate(error, sweep, &text))
    }

    fn load(
        sweep: &Path,
        text: &str,
        file: SweepFile,
        system: Option<&Path>,
        fmus: Option<&Path>,
        input: Option<&Path>,
        sandbox: Sandbox,
    ) -> Result<Self> {
        let beside = || sweep.with_file_name("").join(&file.system);
        let system = system.map_or_else(beside, Path::to_owned);
        let mut description = Description::open(&system)?;
        if let Some(folder) = fmus {
            description.take_fmus_from(folder);
        }
        description.input = input.map(Path::to_owned).or(description.input);
        description.sandbox = sandbox;
        description.start = file.start.unwrap_or(description.start);
        description.stop = file.stop.unwrap_or(description.stop);
        description.step = file.step.unwrap_or(description.step);
        description.order = file.order.unwrap_or(description.order);
        let signals = &file.signals;
        let signals = [&signals.reference, &signals.output, &signals.error, &signals.control];
        let mut seen = HashSet::new();
        let outputs = signals.iter().filter(|name| seen.insert(**name));
        description.outputs = outputs.map(|name| name.to_string()).collect();
        let files = files(&system, &description);
        let fingerprint = fingerprint(text, files.iter().map(|(_, file)| &**file))?;
        let plan = Plan::new(&description)?;
        let parameters = Parameters::new(file.seed, file.draws, file.parameter)?;
        for column in &plan.columns {
            if let kind @ (Type::String | Type::Binary) = column.kind {
                let (name, kind) = (&column.name, kind.as_str());
                bail!("{name} cannot be a signal: it is a {kind}");
            }
        }
        let mut places = [Place::Real(0); 4];
        for (place, name) in places.iter_mut().zip(signals) {
            *place = plan.place(name)?;
        }
        let set = file.set.iter().map(|(name, value)| plan.start(name, value));
        let columns = [Column::new("index", "", Type::Int64)].into_iter();
        let columns = columns.chain(parameters.columns());
        let columns = columns.chain(Metrics::columns());
        let failure = Column::new("failure", "", Type::String).optional();
        let study = Self {
            signals: places,
            set: set.collect::<Result<_>>()?,
            columns: columns.chain([failure]).collect(),
            metrics: file.metrics,
            sweep: sweep.to_owned(),
            plan,
            files,
            input: description.input.as_deref().map(name),
            _package: description.package,
            parameters,
            fingerprint,
        };
        for index in study.parameters.corners() {
            study.starts(index)?;
        }
        Ok(study)
    }

    /// Initializes the FMUs with listed values and the ends of ranges, until they do not crash. Values that an FMU refuses
    /// are those of failed runs.
    ///
    /// # Errors
    /// The FMUs cannot be used, or crash at every value.
    fn try_corners(&self, pool: &mut Pool<'_, Task>) -> Result<()> {
        let (fit, mut crash) = (cell::Cell::new(false), None);
        let corners = self.parameters.corners();
        pool.run(
            corners.len() as u64,
            corners.into_iter().map(Task::Try).take_while(|_| !fit.get()),
            |outcomes: Vec<(Task, TaskOutcome<Reply>)>| {
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

    fn pool<'a>(&self, workers: &'a Workers<'a>) -> Pool<'a, Task> {
        Pool::new(workers, self.plan.names())
    }

    /// Does the tasks of the process that has started this worker process, until an FMU must not be called again.
    ///
    /// # Errors
    /// A task is damaged.
    pub fn work(&self, service: &mut Service) -> Result<()> {
        while let Some(task) = service.task()? {
            let record = service.record();
            let reply = match task {
                Task::Try(index) => match self.initialize(index, record) {
                    Err(error) if error.downcast_ref::<RunError>().is_none() => Err(error),
                    _ => Ok(None),
                },
                Task::Simulate(index) => self.simulate(index, record).map(Some),
            };
            let is_lost = self.plan.components.iter().any(|component| component.fmu.is_lost());
            let reply: Reply = reply.map_err(|error| format!("{error:#}"));
            service.reply(&(reply, is_lost));
            if is_lost {
                break;
            }
        }
        Ok(())
    }

    /// The start values of a run.
    fn starts(&self, index: u64) -> Result<Vec<StartValue>> {
        let mut starts = self.set.clone();
        for (name, value) in self.parameters.run(index)? {
            starts.push(self.plan.start(name, &written(&value))?);
        }
        Ok(starts)
    }

    fn initialize(&self, index: u64, record: &Record) -> Result<Simulation<'_>> {
        let messages = Messages::of_problems(record.clone());
        let starts = self.starts(index);
        let simulation = starts.and_then(|starts| self.plan.simulate(&starts, &messages));
        simulation.with_context(|| format!("run {index}"))
    }

    /// Simulates a run. One that an FMU ends early counts as diverged.
    fn simulate(&self, index: u64, record: &Record) -> Result<FinishedRun> {
        let simulation = match self.initialize(index, record) {
            Ok(simulation) => simulation,
            // It may refuse some of the values.
            Err(error) => {
                return self.unmeasured(index, &error.downcast()?);
            }
        };
        let mut metrics = MetricsAccumulator::new(&self.metrics);
        let (places, gathered) = (&self.signals, &mut metrics);
        let are_first = *places == [0, 1, 2, 3].map(Place::Real);
        let ended = simulation.run(move |row| {
            let [r, y, e, u] = match row.first() {
                Some(first) if are_first => *first,
                _ => numbers(row, places),
            };
            gathered.push(LoopSample { time: row.time, r, y, e, u })
        });
        // A run that an FMU has ended cannot be compared with others either.
        let failure = match ended {
            Ok(finished) => finished.ended,
            Err(error) => Some(error.downcast::<RunError>()?),
        };
        if let Some(failure) = &failure {
            metrics.diverge(failure.time.unwrap_or(self.plan.experiment.start));
        }
        let event = failure.as_ref().map(RunError::event);
        Ok(FinishedRun {
            line: self.line(index, metrics.finish(), event)?,
            failure: failure.map(|failure| failure.to_string()),
        })
    }

    /// The row of a run without metrics, because an FMU has refused it or ended its process.
    fn unmeasured(&self, index: u64, error: &RunError) -> Result<FinishedRun> {
        let summary = Metrics {
            iae: f64::NAN,
            ise: f64::NAN,
            itae: f64::NAN,
            largest_u: f64::NAN,
            diverged: true,
            diverged_at: Some(error.time.unwrap_or(self.plan.experiment.start)),
            ..Metrics::default()
        };
        let line = self.line(index, summary, Some(error.event()))?;
        Ok(FinishedRun { line, failure: Some(error.to_string()) })
    }

    /// The row of a run as a line of CSV.
    fn line(&self, index: u64, summary: Metrics, failure: Option<String>) -> Result<String> {
        let values = self.parameters.run(index)?.into_iter();
        let failure = failure.map(|text| Value::String(text.replace(char::is_control, " ")));
        let cells = [Some(Value::UInt64(index))].into_iter();
        let cells = cells.chain(values.map(|(_, value)| Some(value)));
        let cells = cells.chain(summary.cells());
        let mut line = String::new();
        table::push_line(&mut line, cells.chain([failure]));
        Ok(line)
    }

    /// Simulates runs; `keep` receives lines of runs, and why each run failed. Returns false if cancelled.
    fn execute(
        &self,
        number: u64,
        indices: impl Iterator<Item = u64>,
        pool: &mut Pool<'_, Task>,
        mut keep: impl FnMut(&str, Vec<(u64, Option<String>)>) -> Result<()>,
    ) -> Result<bool> {
        let tasks = indices.map(Task::Simulate);
        pool.run(number, tasks, |outcomes: Vec<(Task, TaskOutcome<Reply>)>| {
            let (mut lines, mut runs) = (String::new(), Vec::new());
            for (Task::Try(index) | Task::Simulate(index), outcome) in outcomes {
                let done = match outcome {
                    TaskOutcome::Reply(Ok(Some(done))) => done,
                    TaskOutcome::Reply(Ok(None)) => continue,
                    TaskOutcome::Reply(Err(text)) => {
                        keep(&lines, runs)?;
                        bail!("{text}");
                    }
                    TaskOutcome::Crash(crash) => self.unmeasured(index, &crash)?,
                };
                lines += &done.line;
                runs.push((index, done.failure));
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
            true => journal.finish(|cell| progress.see(&self.columns, cell))?,
            false => journal.keep()?,
        }
        Ok((is_complete, progress))
    }

    fn journal(&self, file: &Path) -> Result<Journal> {
        let (columns, runs) = (self.columns.clone(), self.parameters.runs);
        Journal::open(file, &self.fingerprint, columns, runs)
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
            [] => journal.finish(|cell| progress.see(&self.columns, cell))?,
            [(0, end)] if end == runs => return journal.remove().map(|()| None),
            _ => return journal.keep().map(|()| None),
        }
        Ok(Some(progress))
    }
}

/// The signals in a row, if they are not its first columns.
#[cold]
#[inline(never)]
fn numbers(row: &Row, places: &[Place; 4]) -> [f64; 4] {
    places.map(|place| row.number(place))
}

/// A value of a run as the user would write it.
fn written(value: &Value) -> Literal {
    match value {
        // Integer parameters accept it too.
        Value::Float64(n) if n.fract() == 0.0 && n.abs() < 1e30 => Literal::Integer(*n as i128),
        Value::Float64(n) => Literal::Real(*n),
        value => Literal::Text(value.to_string()),
    }
}

/// The name of a file.
fn name(file: &Path) -> PathBuf {
    file.file_name().unwrap_or_default().into()
}

/// All files that a system reads, its own first. Their places in a single folder are their names, except that
/// structures of SSP refer to other files by their paths.
fn files(system: &Path, description: &Description) -> Vec<(PathBuf, PathBuf)> {
    let folder = system.parent().unwrap_or(Path::new(""));
    let parts = description.package.iter().flat_map(|package| &package.files);
    let parts = parts.map(|file| (file.strip_prefix(folder).unwrap_or(file).into(), file));
    let fmus = description.components.iter().map(|component| &component.fmu);
    let named = fmus.chain(&description.input).map(|file| (name(file), file));
    let own = Path::new("system").with_extension(system.extension().unwrap_or_default());
    let others = named.chain(parts).map(|(place, file)| (place, file.clone()));
    [(own, system.to_owned())].into_iter().chain(others).collect()
}

/// A digest of everything that the rows depend on: the sweep, and the files of the system.
fn fingerprint<'a>(sweep: &str, files: impl Iterator<Item = &'a Path>) -> Result<String> {
    let mut content = checksum(sweep.as_bytes()).to_le_bytes().to_vec();
    for file in files {
        let bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        content.extend_from_slice(&checksum(&bytes).to_le_bytes());
    }
    Ok(format!("{:032x}", checksum(&content)))
}

#[cfg(test)]
mod tests {
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
            progress.see(&columns, &|place| Some(row[place].clone()));
        }
        assert_eq!(progress.best, Some((2.0, "run 3, a.k = 8.0".to_owned())));
        assert_eq!(progress.diverged, 2);
        assert_eq!(progress.first_diverged.as_deref(), Some("run 1, a.k = 2.0"));
    }
}
