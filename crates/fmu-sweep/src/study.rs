//! A study: a sweep file applied to its system, run by run.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use fmu_cosim::{Description, Failure, Order, Simulation, Start, Value};
use fmu_description::guid::checksum;
use serde::{Deserialize, Serialize};

use crate::{Cell, Columns, Journal, Metrics, Parameter, Plan, Run, Sample, Summary};

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
    /// The first run that an FMU ended early, and why.
    first_failure: Mutex<Option<(u64, Failure)>>,
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

/// Progress of [`Study::write`].
#[derive(Debug, Clone, Copy)]
pub struct Progress {
    /// Total number of runs.
    pub runs: u64,
    /// Number of runs that were already in the journal.
    pub before: u64,
}

impl Study {
    /// Reads a sweep file and loads the FMUs of its system. `system` and `fmus` override the system
    /// file and the folder of its FMUs.
    ///
    /// # Errors
    /// A file cannot be read, or its contents do not fit.
    pub fn open(sweep: &Path, system: Option<&Path>, fmus: Option<&Path>) -> Result<Self> {
        let text = fs::read_to_string(sweep).context("cannot read it")?;
        let file: File = toml::from_str(&text)?;
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
        let fingerprint = fingerprint(&text, &files)?;
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
            columns: Columns::new(plan.columns().into_iter().chain(Summary::columns()))?,
            metrics: file.metrics,
            first_failure: Mutex::new(None),
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
    /// A value is rejected.
    pub fn try_corners(&self) -> Result<()> {
        for index in self.plan.corners() {
            self.initialize(&self.plan.run(index)?)?;
        }
        Ok(())
    }

    fn starts(&self, run: &Run<'_>) -> Result<Vec<Start>> {
        let values = run.assignments.iter();
        starts(
            &self.system,
            values.map(|(name, value)| (*name, convert(value))),
        )
    }

    fn initialize(&self, run: &Run<'_>) -> Result<Simulation<'_>> {
        let start = || {
            let mut starts = self.set.clone();
            starts.extend(self.starts(run)?);
            self.system.simulate(&starts)
        };
        start().with_context(|| format!("run {}", run.index))
    }

    /// Simulates a run and returns its metrics. A run that an FMU ends early counts as diverged.
    fn simulate(&self, run: &Run<'_>) -> Result<[Cell; 9]> {
        let simulation = self.initialize(run)?;
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
        if let Err(error) = ended {
            let failure: Failure = error.downcast()?;
            metrics.diverge(failure.time.unwrap_or(self.system.experiment().start));
            self.remember(run.index, failure);
        }
        Ok(metrics.finish().cells())
    }

    fn remember(&self, run: u64, failure: Failure) {
        if let Ok(mut first) = self.first_failure.lock()
            && first.as_ref().is_none_or(|(known, _)| run < *known)
        {
            *first = Some((run, failure));
        }
    }

    /// Simulates runs; `keep` receives the line and the row of each.
    fn execute(
        &self,
        indices: impl Iterator<Item = u64> + Send,
        threads: usize,
        keep: impl Fn(&str, &crate::Row) -> Result<()> + Sync,
    ) -> Result<()> {
        // A kill only loses the runs in progress, so cancellation is not needed.
        let never = AtomicBool::new(false);
        let simulate = |(): &mut (), run: &Run<'_>| self.simulate(run);
        crate::execute(
            &self.plan,
            indices,
            threads,
            &never,
            || Ok(()),
            simulate,
            |row| keep(&self.columns.line(&row)?, &row),
        )?;
        Ok(())
    }

    /// Simulates some runs; `keep` receives the line of each as soon as it is ready.
    ///
    /// # Errors
    /// The plan has no such runs, a run cannot be started, or `keep` fails.
    pub fn rows(
        &self,
        runs: Range<u64>,
        threads: usize,
        keep: impl Fn(&str) -> Result<()> + Sync,
    ) -> Result<()> {
        self.plan.check(runs.clone())?;
        self.execute(runs, threads, |line, _| keep(line))
    }

    /// Simulates the runs that are not yet in the journal of `file`, and writes all rows to `file`.
    /// `begin` is called before the first run; the closure it returns is called after every run.
    ///
    /// # Errors
    /// The journal belongs to another sweep, a file cannot be written, or a run cannot be started.
    pub fn write<F: Fn() + Sync>(
        &self,
        file: &Path,
        threads: usize,
        begin: impl FnOnce(Progress) -> F,
    ) -> Result<()> {
        let runs = self.plan.runs();
        let journal = Journal::open(file, &self.fingerprint, self.columns.clone(), runs)?;
        let pending: Vec<u64> = journal.pending(0..runs).collect();
        let before = runs - pending.len() as u64;
        let ended = begin(Progress { runs, before });
        self.execute(pending.into_iter(), threads, |_, row| {
            journal.append(row)?;
            ended();
            Ok(())
        })?;
        Ok(journal.finish()?)
    }

    /// The first run that an FMU ended early, and why.
    pub fn first_failure(&self) -> Option<(u64, String)> {
        let first = self.first_failure.lock().ok()?;
        first
            .as_ref()
            .map(|(run, failure)| (*run, failure.to_string()))
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
