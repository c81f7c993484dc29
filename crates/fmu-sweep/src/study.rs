//! A study: a sweep file applied to its system, run by run.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use fmu_cosim::{
    Description, Failure, Messages, Order, Recorder, Simulation, Start, Value, locate,
};
use fmu_description::guid::checksum;
use serde::{Deserialize, Serialize};

use crate::workers::{Crash, Outcome, Pool, Workers, serve};
use crate::{Column, Columns, Journal, Kind, Metrics, Parameter, Plan, Row, Run, Sample, Summary};

/// The name of the last column: why a run failed, empty if it did not.
pub const FAILURE: &str = "failure";

/// The contents of a sweep file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// The system file, relative to the folder of the sweep file.
    system: PathBuf,
    /// Times and order that override those of the system.
    start: Option<f64>,
    stop: Option<f64>,
    step: Option<f64>,
    order: Option<Order>,
    /// Start values of all runs, which override those of the system.
    #[serde(default)]
    set: BTreeMap<String, Value>,
    #[serde(default)]
    seed: u64,
    #[serde(default = "one")]
    draws: u64,
    #[serde(default)]
    parameter: Vec<Parameter>,
    signals: Signals,
    #[serde(default)]
    metrics: crate::Options,
}

fn one() -> u64 {
    1
}

/// The variables from which the metrics are computed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Signals {
    reference: String,
    output: String,
    error: String,
    control: String,
}

/// A sweep that is ready to run.
pub struct Study {
    /// The sweep file.
    sweep: PathBuf,
    system: fmu_cosim::Plan,
    /// The files that it depends on: the system, then the FMUs.
    files: Vec<PathBuf>,
    plan: Plan,
    columns: Columns,
    fingerprint: String,
    set: Vec<Start>,
    /// The columns of reference, output, error and control in a row of the system.
    signals: [usize; 4],
    metrics: crate::Options,
}

/// The information that the coordinator of a distributed sweep needs.
#[derive(Debug, Serialize)]
pub struct Outline<'a> {
    /// Number of runs.
    pub runs: u64,
    /// Header of the journal.
    pub header: String,
    /// The system file.
    pub system: &'a Path,
    /// Its FMUs.
    pub fmus: &'a [PathBuf],
}

/// The outcome of a sweep without errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// All runs are done.
    Complete,
    /// The sweep was cancelled before all runs were done.
    Cancelled,
}

/// Progress of [`Study::write`].
#[derive(Debug, Clone, Default)]
pub struct Progress {
    /// Total number of runs.
    pub runs: u64,
    /// Number of runs that were already in the journal.
    pub before: u64,
    /// Number of runs done since.
    pub done: u64,
    /// Number of these that failed.
    pub failed: u64,
    /// The first of these, and why.
    pub first_failure: Option<(u64, String)>,
}

/// Marks the task of setting the values of a run without simulating it.
const CORNER: u64 = 1 << 63;

impl Study {
    /// Reads a sweep file and loads the FMUs of its system. `system` and `fmus` override the system
    /// file and the folder of its FMUs.
    ///
    /// # Errors
    /// A file cannot be read, or its contents do not fit.
    pub fn open(sweep: &Path, system: Option<&Path>, fmus: Option<&Path>) -> Result<Self> {
        let text = fs::read_to_string(sweep)
            .with_context(|| format!("cannot read {}", sweep.display()))?;
        let file: File = toml::from_str(&text).with_context(|| sweep.display().to_string())?;
        Self::load(sweep, &text, file, system, fmus).map_err(|error| locate(error, sweep, &text))
    }

    fn load(
        sweep: &Path,
        text: &str,
        file: File,
        system: Option<&Path>,
        fmus: Option<&Path>,
    ) -> Result<Self> {
        let system = match system {
            Some(system) => system.to_owned(),
            None => sweep.with_file_name("").join(&file.system),
        };
        let mut description = Description::read(&system)?;
        if let Some(folder) = fmus {
            description.take_fmus_from(folder);
        }
        apply(&file, &mut description);
        let files: Vec<_> = std::iter::once(system)
            .chain(description.components.iter().map(|c| c.fmu.clone()))
            .collect();
        let fingerprint = fingerprint(text, &files)?;
        file.metrics.check()?;
        let system = fmu_cosim::Plan::new(&description)?;
        let plan = Plan::new(file.seed, file.draws, file.parameter)?;
        let study = Self {
            signals: signals(&system, &file.signals)?,
            set: starts(
                &system,
                file.set
                    .iter()
                    .map(|(name, value)| (name.as_str(), value.clone())),
            )?,
            columns: columns(&plan)?,
            metrics: file.metrics,
            sweep: sweep.to_owned(),
            system,
            files,
            plan,
            fingerprint,
        };
        for index in study.plan.corners() {
            study.starts(&study.plan.run(index)?)?;
        }
        Ok(study)
    }

    /// Sets every listed value and the ends of every range in the FMUs, so that a rejected value is
    /// reported before the first run rather than hours later.
    ///
    /// # Errors
    /// A value is rejected, or the FMUs crash at every value.
    pub fn try_corners(&self, workers: &Workers<'_>) -> Result<()> {
        self.try_corners_in(&mut self.pool(workers))
    }

    fn try_corners_in(&self, pool: &mut Pool<'_>) -> Result<()> {
        let (mut fit, mut crash) = (false, None);
        let corners = self.plan.corners().into_iter().map(|run| CORNER | run);
        let file = || self.sweep.display().to_string();
        pool.run(corners, |_, outcome| {
            match outcome {
                Outcome::Reply(reply) => {
                    Reply::read(&reply).with_context(file)?;
                    fit = true;
                }
                Outcome::Crash(crashed) => crash = Some(crashed.text),
            }
            Ok(())
        })?;
        // A crash at some values is recorded with their runs.
        match crash {
            Some(text) if !fit => bail!("{}: {text}", self.sweep.display()),
            _ => Ok(()),
        }
    }

    fn pool<'a>(&self, workers: &'a Workers<'a>) -> Pool<'a> {
        Pool::new(workers, self.system.names())
    }

    /// Does the tasks of the process that has started this worker process.
    ///
    /// # Errors
    /// The folder is not that of a worker.
    pub fn work(&self, folder: &Path) -> Result<()> {
        Ok(serve(folder, |task, recorder| {
            let reply = match task & CORNER {
                0 => self.simulate(task, recorder).map(Some),
                _ => self.try_corner(task & !CORNER, recorder).map(|()| None),
            };
            Reply::write(reply)
        })?)
    }

    fn starts(&self, run: &Run<'_>) -> Result<Vec<Start>> {
        let values = run.assignments.iter();
        starts(
            &self.system,
            values.map(|(name, value)| (*name, convert(value))),
        )
    }

    fn try_corner(&self, index: u64, recorder: &Recorder) -> Result<()> {
        self.initialize(&self.plan.run(index)?, recorder).map(drop)
    }

    fn initialize(&self, run: &Run<'_>, recorder: &Recorder) -> Result<Simulation<'_>> {
        let start = || {
            let mut starts = self.set.clone();
            starts.extend(self.starts(run)?);
            let messages = Messages::recorded(recorder.clone());
            self.system.simulate_with(&starts, &messages)
        };
        start().with_context(|| format!("run {}", run.index))
    }

    /// Simulates a run. One that an FMU ends early counts as diverged.
    fn simulate(&self, index: u64, recorder: &Recorder) -> Result<Reply> {
        let run = self.plan.run(index)?;
        let simulation = self.initialize(&run, recorder)?;
        let mut metrics = Metrics::new(&self.metrics);
        let [r, y, e, u] = self.signals;
        let ended = simulation.run_while(|time, row| {
            metrics.push(Sample {
                time,
                r: row[r],
                y: row[y],
                e: row[e],
                u: row[u],
            })
        });
        let mut failure = None;
        if let Err(error) = ended {
            let failed: Failure = error.downcast()?;
            metrics.diverge(failed.time.unwrap_or(self.system.experiment().start));
            failure = Some(failed);
        }
        let event = failure.as_ref().map(Failure::event);
        let row = self.row(&run, metrics.finish(), event);
        Ok(Reply {
            line: self.columns.line(&row)?,
            failure: failure.map(|failure| failure.to_string()),
        })
    }

    /// The row of a run whose process an FMU has ended, and with it the metrics until then.
    fn crashed(&self, index: u64, crash: Crash) -> Result<Reply> {
        let time = crash.time.unwrap_or(self.system.experiment().start);
        let summary = Summary {
            iae: f64::NAN,
            ise: f64::NAN,
            itae: f64::NAN,
            largest_u: f64::NAN,
            diverged: true,
            diverged_at: Some(time),
            ..Summary::default()
        };
        let row = self.row(&self.plan.run(index)?, summary, Some(crash.event));
        Ok(Reply {
            line: self.columns.line(&row)?,
            failure: Some(crash.text),
        })
    }

    fn row(&self, run: &Run<'_>, summary: Summary, failure: Option<String>) -> Row {
        let failure = failure.map(|text| crate::Value::Text(text.replace(char::is_control, " ")));
        run.row(summary.cells().into_iter().chain([failure]))
    }

    /// Simulates runs; `keep` receives the line of each, and why it failed. Returns false if cancelled.
    fn execute(
        &self,
        indices: impl Iterator<Item = u64>,
        pool: &mut Pool<'_>,
        mut keep: impl FnMut(u64, Reply) -> Result<()>,
    ) -> Result<bool> {
        pool.run(indices, |index, outcome| {
            let reply = match outcome {
                Outcome::Reply(reply) => Reply::read(&reply)?,
                Outcome::Crash(crash) => self.crashed(index, crash)?,
            };
            keep(index, reply)
        })
    }

    /// Simulates some runs; `keep` receives the line of each as soon as it is ready. Returns whether all
    /// are done.
    ///
    /// # Errors
    /// The plan has no such runs, a run cannot be started, or `keep` fails.
    pub fn rows(
        &self,
        runs: Range<u64>,
        workers: &Workers<'_>,
        mut keep: impl FnMut(&str) -> Result<()>,
    ) -> Result<Ended> {
        self.plan.check(runs.clone())?;
        let pool = &mut self.pool(workers);
        let all = self.execute(runs, pool, |_, reply| keep(&reply.line))?;
        Ok(if all {
            Ended::Complete
        } else {
            Ended::Cancelled
        })
    }

    /// Simulates the runs that are not yet in the journal of `file`, and writes all rows to `file`.
    /// `report` is called before the first run and after every run.
    ///
    /// # Errors
    /// The journal belongs to another sweep, a file cannot be written, or a run cannot be started.
    pub fn write(
        &self,
        file: &Path,
        workers: &Workers<'_>,
        mut report: impl FnMut(&Progress),
    ) -> Result<(Ended, Progress)> {
        let pool = &mut self.pool(workers);
        self.try_corners_in(pool)?;
        let runs = self.plan.runs();
        let journal = Journal::open(file, &self.fingerprint, self.columns.clone(), runs)?;
        let pending: Vec<u64> = journal.pending(0..runs).collect();
        let mut progress = Progress {
            runs,
            before: runs - pending.len() as u64,
            ..Progress::default()
        };
        report(&progress);
        let all = self.execute(pending.into_iter(), pool, |index, reply| {
            journal.append_line(&reply.line)?;
            progress.count(index, reply.failure);
            report(&progress);
            Ok(())
        })?;
        if !all {
            journal.sync()?;
            return Ok((Ended::Cancelled, progress));
        }
        journal.finish()?;
        Ok((Ended::Complete, progress))
    }

    /// The information that the coordinator of a distributed sweep needs.
    ///
    /// # Errors
    /// A name is not allowed in the header of a journal.
    pub fn outline(&self) -> Result<Outline<'_>> {
        let (system, fmus) = self.files.split_first().context("there is no system")?;
        Ok(Outline {
            runs: self.plan.runs(),
            header: crate::journal::header(&self.fingerprint, &self.columns)?,
            system,
            fmus,
        })
    }
}

impl Progress {
    fn count(&mut self, run: u64, failure: Option<String>) {
        self.done += 1;
        if let Some(failure) = failure {
            self.failed += 1;
            if self
                .first_failure
                .as_ref()
                .is_none_or(|(first, _)| run < *first)
            {
                self.first_failure = Some((run, failure));
            }
        }
    }
}

/// The answer of a worker: the line of a run, and why it failed with the words of the FMU.
struct Reply {
    line: String,
    failure: Option<String>,
}

impl Reply {
    /// The bytes of an answer: a letter for its kind, and texts that end with a zero byte.
    fn write(reply: Result<Option<Self>>) -> Vec<u8> {
        match reply {
            Ok(None) => "c".to_owned(),
            Ok(Some(Self { line, failure })) => match failure {
                None => format!("r{line}"),
                Some(failure) => format!("f{line}\0{failure}"),
            },
            Err(error) => format!("e{error:#}"),
        }
        .into_bytes()
    }

    fn read(bytes: &[u8]) -> Result<Self> {
        let text = String::from_utf8_lossy(bytes);
        let (kind, rest) = text.split_at_checked(1).unwrap_or_default();
        let (line, failure) = match rest.split_once('\0') {
            Some((line, failure)) => (line, Some(failure.to_owned())),
            None => (rest, None),
        };
        ensure!(kind != "e", "{rest}");
        Ok(Self {
            line: line.to_owned(),
            failure,
        })
    }
}

/// The columns of a plan: parameters, metrics and the reason of a failure.
fn columns(plan: &Plan) -> Result<Columns> {
    let failure = Column {
        name: FAILURE.to_owned(),
        kind: Kind::Text,
        optional: true,
    };
    let parameters = plan.columns().into_iter();
    Ok(Columns::new(
        parameters.chain(Summary::columns()).chain([failure]),
    )?)
}

/// Applies the settings of the sweep file to the system.
fn apply(file: &File, description: &mut Description) {
    description.start = file.start.unwrap_or(description.start);
    description.stop = file.stop.unwrap_or(description.stop);
    description.step = file.step.unwrap_or(description.step);
    description.order = file.order.unwrap_or(description.order);
    let Signals {
        reference,
        output,
        error,
        control,
    } = &file.signals;
    description.outputs.clear();
    for name in [reference, output, error, control] {
        if !description.outputs.contains(name) {
            description.outputs.push(name.clone());
        }
    }
}

fn signals(system: &fmu_cosim::Plan, signals: &Signals) -> Result<[usize; 4]> {
    Ok([
        system.column(&signals.reference)?,
        system.column(&signals.output)?,
        system.column(&signals.error)?,
        system.column(&signals.control)?,
    ])
}

fn starts<'a>(
    system: &fmu_cosim::Plan,
    values: impl Iterator<Item = (&'a str, Value)>,
) -> Result<Vec<Start>> {
    values
        .map(|(name, value)| system.start(name, &value))
        .collect()
}

fn convert(value: &crate::Value) -> Value {
    match value {
        // Integer parameters accept it too.
        crate::Value::Number(n) if n.fract() == 0.0 && n.abs() < 1e15 => Value::Integer(*n as i64),
        crate::Value::Number(n) => Value::Real(*n),
        crate::Value::Boolean(value) => Value::Boolean(*value),
        crate::Value::Text(text) => Value::Text(text.clone()),
    }
}

/// A digest of everything that the rows depend on: the sweep, the system and the FMUs.
fn fingerprint(sweep: &str, files: &[PathBuf]) -> Result<String> {
    let mut content = checksum(sweep.as_bytes()).to_le_bytes().to_vec();
    for file in files {
        let bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        content.extend_from_slice(&checksum(&bytes).to_le_bytes());
    }
    Ok(format!("{:032x}", checksum(&content)))
}
