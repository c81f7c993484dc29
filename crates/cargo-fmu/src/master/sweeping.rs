//! The runs of a sweep: the file, one run and its metrics, and all of them.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use fmu_cosim::{Description, Failure, Order, Plan, Simulation, Start, Value};
use fmu_description::guid::checksum;
use fmu_sweep::{Cell, Columns, Journal, Metrics, Parameter, Run, Sample, Summary};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Deserialize;

use super::sweep::Options;

/// A sweep, as its file describes it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// The system, as seen from the folder of the file.
    system: PathBuf,
    /// Times and order in place of those of the system.
    start: Option<f64>,
    stop: Option<f64>,
    step: Option<f64>,
    order: Option<Order>,
    /// Start values of all runs, in place of those of the system.
    #[serde(default)]
    set: BTreeMap<String, Value>,
    #[serde(default)]
    seed: u64,
    #[serde(default = "one")]
    draws: u64,
    #[serde(default)]
    parameter: Vec<Parameter>,
    #[serde(default)]
    signals: Signals,
    #[serde(default)]
    metrics: fmu_sweep::Options,
}

fn one() -> u64 {
    1
}

/// The variables that the metrics are of.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Signals {
    reference: String,
    output: String,
    error: String,
    control: String,
}

impl Default for Signals {
    fn default() -> Self {
        Self {
            reference: "source.r".into(),
            output: "plant.theta".into(),
            error: "controller.e".into(),
            control: "controller.u".into(),
        }
    }
}

/// A sweep that is ready to run.
struct Study {
    system: Plan,
    /// Files that it is made of: the system, then the FMUs.
    files: Vec<PathBuf>,
    plan: fmu_sweep::Plan,
    columns: Columns,
    fingerprint: String,
    set: Vec<Start>,
    /// The columns of reference, output, error and control in a row of the system.
    signals: [usize; 4],
    metrics: fmu_sweep::Options,
    /// The first run that broke off, and why.
    first_failure: Mutex<Option<(u64, Failure)>>,
}

/// Runs the sweep, or what the options want of it.
///
/// # Errors
/// What does not fit in the files; a start value that an FMU refuses; a file that cannot be written.
pub fn run(options: &Options, out: &mut impl Write) -> Result<()> {
    let file = || options.sweep.display().to_string();
    let study = Study::new(options).with_context(file)?;
    if let Some(rows) = &options.rows {
        study.plan.check(rows.0.clone())?;
        return study.execute(rows.0.clone(), options.threads, |line, _| {
            Ok(io::stdout().lock().write_all(line.as_bytes())?)
        });
    }
    study.try_corners().with_context(file)?;
    match options.plan {
        true => study.describe(out),
        false => study.write(options, out),
    }
}

impl Study {
    fn new(options: &Options) -> Result<Self> {
        let text = fs::read_to_string(&options.sweep).context("cannot read it")?;
        let file: File = toml::from_str(&text)?;
        let system = match &options.system {
            Some(system) => system.clone(),
            None => options.sweep.with_file_name("").join(&file.system),
        };
        let mut description = Description::read(&system)?;
        if let Some(folder) = &options.fmus {
            description.take_fmus_from(folder);
        }
        apply(&file, &mut description);
        let fingerprint = fingerprint(&file, &description)?;
        let files = std::iter::once(system)
            .chain(description.components.iter().map(|c| c.fmu.clone()))
            .collect();
        file.metrics.check()?;
        let system = Plan::new(&description)?;
        let plan = fmu_sweep::Plan::new(file.seed, file.draws, file.parameter)?;
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

    /// Has the FMUs take every listed value and the ends of every range, so that the user is told of
    /// one that they refuse before the first run, and not hours later.
    fn try_corners(&self) -> Result<()> {
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

    /// One run, and its metrics. A run that an FMU breaks off diverged.
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

    /// Simulates runs; `keep` gets the line of each, and its row.
    fn execute(
        &self,
        indices: impl Iterator<Item = u64> + Send,
        threads: usize,
        keep: impl Fn(&str, &fmu_sweep::Row) -> Result<()> + Sync,
    ) -> Result<()> {
        // A kill loses nothing but the runs under way, so nothing needs to be cancelled.
        let never = AtomicBool::new(false);
        let simulate = |(): &mut (), run: &Run<'_>| self.simulate(run);
        fmu_sweep::execute(
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

    /// Does the runs that are left, and writes all rows to their file.
    fn write(&self, options: &Options, out: &mut impl Write) -> Result<()> {
        let file = match &options.out {
            Some(file) => file.clone(),
            None => {
                let name = options.sweep.file_stem().unwrap_or_default();
                Path::new(name).with_extension("csv")
            }
        };
        let runs = self.plan.runs();
        let journal = Journal::open(&file, &self.fingerprint, self.columns.clone(), runs)?;
        let pending: Vec<u64> = journal.pending(0..runs).collect();
        let (done, left) = (runs - pending.len() as u64, pending.len());
        let bar = progress_bar(runs, done)?;
        let begin = Instant::now();
        self.execute(pending.into_iter(), options.threads, |_, row| {
            journal.append(row)?;
            bar.inc(1);
            Ok(())
        })?;
        let elapsed = begin.elapsed().as_secs_f64();
        bar.finish_and_clear();
        journal.finish()?;
        writeln!(
            out,
            "{left} runs in {elapsed:.3} s: {:.0} a second",
            left as f64 / elapsed
        )?;
        if done > 0 {
            writeln!(out, "{done} runs were done before")?;
        }
        if let Ok(Some((run, failure))) = self.first_failure.lock().as_deref() {
            writeln!(
                out,
                "runs broke off, the first of them run {run}: {failure}"
            )?;
        }
        writeln!(out, "wrote {}: {runs} rows", file.display())?;
        Ok(())
    }

    /// What a coordinator needs: the number of runs, the head of the journal, the files.
    fn describe(&self, out: &mut impl Write) -> Result<()> {
        let plan = serde_json::json!({
            "runs": self.plan.runs(),
            "header": fmu_sweep::journal::header(&self.fingerprint, &self.columns)?,
            "system": self.files[0],
            "fmus": self.files[1..],
        });
        Ok(writeln!(out, "{plan}")?)
    }
}

/// What the file of the sweep says of the system.
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

fn signals(system: &Plan, signals: &Signals) -> Result<[usize; 4]> {
    Ok([
        system.column(&signals.reference)?,
        system.column(&signals.output)?,
        system.column(&signals.error)?,
        system.column(&signals.control)?,
    ])
}

fn starts<'a>(system: &Plan, values: impl Iterator<Item = (&'a str, Value)>) -> Result<Vec<Start>> {
    values
        .map(|(name, value)| system.start(name, &value))
        .collect()
}

fn convert(value: &fmu_sweep::Value) -> Value {
    match value {
        // A parameter of type Integer takes it too.
        fmu_sweep::Value::Number(n) if n.fract() == 0.0 && n.abs() < 1e15 => {
            Value::Integer(*n as i64)
        }
        fmu_sweep::Value::Number(n) => Value::Real(*n),
        fmu_sweep::Value::Boolean(value) => Value::Boolean(*value),
        fmu_sweep::Value::Text(text) => Value::Text(text.clone()),
    }
}

/// A digest of all that the rows depend on: the sweep, the system, the content of the FMUs.
fn fingerprint(file: &File, description: &Description) -> Result<String> {
    let mut content = Vec::new();
    let mut system = description.clone();
    for component in &mut system.components {
        let fmu = fs::read(&component.fmu)
            .with_context(|| format!("cannot read {}", component.fmu.display()))?;
        content.extend_from_slice(&checksum(&fmu).to_le_bytes());
        component.fmu = PathBuf::new();
    }
    content.extend_from_slice(format!("{file:?}{system:?}").as_bytes());
    Ok(format!("{:032x}", checksum(&content)))
}

fn progress_bar(runs: u64, done: u64) -> Result<ProgressBar> {
    ensure!(done <= runs, "there are more rows than runs");
    let bar = ProgressBar::new(runs).with_position(done);
    let style = "[{bar:40}] {pos} of {len} runs, {per_sec}, {eta} left";
    bar.set_style(ProgressStyle::with_template(style)?.progress_chars("=> "));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar.reset_eta();
    Ok(bar)
}
