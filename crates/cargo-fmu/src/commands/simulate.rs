//! `cargo fmu simulate`: one run of a system of coupled FMUs, in a process of its own, since an FMU
//! may crash, hang or exit.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Error, Result, anyhow, bail};
use clap::{Args, ValueEnum};
use fmu_cosim::{
    Csv, Description, Experiment, Failure, Kept, Message, Messages, Plan, Recorder, Supervised,
    Value, locate,
};
use fmu_worker::Ended;
use indicatif::{ProgressBar, ProgressStyle};

use super::worker::{self, Limited};
use crate::session::{self, Session};
use crate::style::WARNING;
use crate::table;

/// The system to simulate, and changes to it.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// System file, such as those in examples/closed-loop
    #[arg(value_name = "SYSTEM.toml")]
    system: PathBuf,
    /// Set a start value (for an enumeration, the name of an item); may be repeated
    #[arg(long = "set", value_name = "COMPONENT.VARIABLE=VALUE")]
    sets: Vec<Assignment>,
    /// Start time in s
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    start: Option<f64>,
    /// Stop time, the last recorded communication point, in s
    #[arg(long, value_name = "T", allow_negative_numbers = true)]
    stop: Option<f64>,
    /// Communication step size in s
    #[arg(long, value_name = "H", allow_negative_numbers = true)]
    step: Option<f64>,
    /// Relative tolerance of all components
    #[arg(long, value_name = "TOLERANCE")]
    tolerance: Option<f64>,
    /// Order of stepping
    #[arg(long)]
    order: Option<Order>,
    /// Variable to record; may be repeated
    #[arg(long = "output", value_name = "COMPONENT.VARIABLE")]
    outputs: Vec<String>,
    /// Folder of the FMUs
    #[arg(long, value_name = "DIR")]
    fmus: Option<PathBuf>,
    /// Write the time and the recorded variables to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    limited: Limited,
}

/// Order of stepping.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Order {
    /// One component after the other, using the newest outputs (Gauss-Seidel)
    Sequential,
    /// All components at once, using the outputs before the step (Jacobi)
    Parallel,
}

/// `COMPONENT.VARIABLE=VALUE`
#[derive(Debug, Clone)]
struct Assignment {
    /// The variable.
    name: String,
    /// Its value.
    value: String,
}

impl FromStr for Assignment {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        let (name, value) = text
            .split_once('=')
            .filter(|(name, _)| name.contains('.'))
            .context("expected COMPONENT.VARIABLE=VALUE, such as controller.pid.kp=250")?;
        Ok(Self {
            name: name.into(),
            value: value.into(),
        })
    }
}

/// Interval between progress updates: short enough to look smooth without slowing the run.
const PERIOD: Duration = Duration::from_millis(50);

/// Simulates the system in a worker process and reports the results.
///
/// # Errors
/// The system file or the options are invalid, or an FMU returns an error, crashes or hangs.
pub fn run(args: &SimulateArgs, out: &mut impl Write) -> Result<ExitCode> {
    match &args.limited.worker {
        Some(folder) => {
            session::end_with_supervisor(folder);
            let recorder = Recorder::open(&folder.join(worker::CALLS))?;
            let outcome = work(args, folder, &recorder, out);
            recorder.finish();
            outcome.map(|()| ExitCode::SUCCESS)
        }
        None => supervise(args),
    }
}

/// Starts the worker process, waits for it, and reports what it cannot report itself.
fn supervise(args: &SimulateArgs) -> Result<ExitCode> {
    let session = Session::start()?;
    let folder = session.folder();
    let recorder = Recorder::create(&folder.join(worker::CALLS))?;
    let child = session.worker(folder)?.spawn()?;
    let mut process = Supervised::new(child, recorder.clone(), args.limited.limits(1)?);
    let mut pause = Duration::from_millis(1);
    let ended = loop {
        if let Some(signal) = session.signal() {
            drop(process);
            let time = recorder.time().map(|time| format!(" at t = {time:?} s"));
            let time = time.unwrap_or_default();
            anstream::eprintln!("interrupted{time}{}", kept(args, rescue(args, folder)?));
            return Ok(session::code(signal));
        }
        if let Some(ended) = process.poll()? {
            break ended;
        }
        if let Some(call) = process.newly_slow(&worker::names(folder)) {
            worker::report_slow(&call);
        }
        thread::sleep(pause);
        pause = (2 * pause).min(WORKER_PERIOD);
    };
    match ended {
        Ended::Exited(status) if recorder.is_finished() => {
            if status.code().is_none() {
                anstream::eprintln!(
                    "{WARNING}warning:{WARNING:#} after the simulation, the process {ended}"
                );
            }
            let failed = status.code().is_some_and(|code| code != 0);
            Ok(if failed {
                ExitCode::FAILURE
            } else {
                ExitCode::SUCCESS
            })
        }
        _ => {
            let text = worker::explain(&recorder, &worker::names(folder), &ended);
            bail!("{text}{}", kept(args, rescue(args, folder)?))
        }
    }
}

/// Interval between checks of a worker process that runs for long.
const WORKER_PERIOD: Duration = Duration::from_millis(20);

/// Completes the file of a worker that was ended.
fn rescue(args: &SimulateArgs, folder: &Path) -> Result<Option<Kept>> {
    let Some(path) = &args.csv else {
        return Ok(None);
    };
    Csv::rescue(path, &folder.join(worker::ROWS))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// Adds the system file to an error, and the line unless the value may come from an option.
fn located(args: &SimulateArgs, error: Error) -> Error {
    let text = match args.start.or(args.stop).or(args.step) {
        None => fs::read_to_string(&args.system).unwrap_or_default(),
        Some(_) => String::new(),
    };
    locate(error, &args.system, &text)
}

/// Says where the rows of a failed run are.
fn kept(args: &SimulateArgs, kept: Option<Kept>) -> String {
    match kept {
        Some(kept) => format!("; {kept}"),
        None if args.csv.is_some() => "; no file was written".to_owned(),
        None => String::new(),
    }
}

/// Simulates the system in this process and reports the results. The rows that are not yet in the file
/// are in the folder, where the supervisor finds them after a crash.
fn work(
    args: &SimulateArgs,
    folder: &Path,
    recorder: &Recorder,
    out: &mut impl Write,
) -> Result<()> {
    let mut description = describe(args)?;
    let mut plan = Plan::new(&description).map_err(|error| located(args, error))?;
    let value = |set: &Assignment| Value::Text(set.value.clone());
    let (sizes, sets): (Vec<_>, Vec<_>) =
        (args.sets.iter()).partition(|set| plan.is_structural(&set.name));
    if !sizes.is_empty() {
        for set in sizes {
            description.set_start(&set.name, value(set));
        }
        plan = Plan::new(&description)?;
    }
    worker::write_names(folder, &plan.names())?;
    let starts =
        (sets.iter().map(|set| plan.start(&set.name, &value(set)))).collect::<Result<Vec<_>>>()?;
    let mut csv = match &args.csv {
        Some(path) => Some(Csv::shared(
            path,
            plan.columns(),
            &folder.join(worker::ROWS),
        )?),
        None => None,
    };
    let mut progress = Progress::new(plan.experiment())?;
    let mut last = (
        plan.experiment().start,
        vec![f64::NAN; plan.columns().len()],
    );
    let mut begin = Instant::now();
    let messages = Messages::recorded(recorder.clone());
    let mut written = Ok(());
    let outcome = plan
        .simulate_with(&starts, &messages)
        .and_then(|simulation| {
            // Loading the binaries and initializing the FMUs do not count as simulating.
            begin = Instant::now();
            simulation.run_while(|time, row| {
                if let Some(csv) = &mut csv {
                    written = csv.push(time, row);
                }
                progress.tick(time);
                if progress.is_complete() {
                    last = (time, row.to_vec());
                }
                written.is_ok()
            })
        });
    let elapsed = begin.elapsed();
    progress.bar.finish_and_clear();
    let logged = match &outcome {
        Ok(logged) => logged,
        Err(_) => &messages.take(),
    };
    logged
        .iter()
        .filter(|message| message.warning)
        .for_each(warn);
    written?;
    if let Err(error) = outcome {
        let kept = kept(args, csv.and_then(Csv::keep));
        return match error.downcast::<Failure>() {
            Ok(failure) => Err(anyhow!("{failure}{kept}")),
            Err(error) => Err(error),
        };
    }
    let rows = csv.map(Csv::finish).transpose()?;
    report(out, &plan, &last, elapsed)?;
    if let (Some(rows), Some(path)) = (rows, &args.csv) {
        writeln!(out, "wrote {}: {rows} rows", path.display())?;
    }
    // What an FMU does when its binary is unloaded no longer matters.
    recorder.finish();
    Ok(())
}

/// Reads the system file and applies the options.
fn describe(args: &SimulateArgs) -> Result<Description> {
    let mut description = Description::read(&args.system)?;
    let of = |option: Option<f64>, file: f64| option.unwrap_or(file);
    description.start = of(args.start, description.start);
    description.stop = of(args.stop, description.stop);
    description.step = of(args.step, description.step);
    if args.tolerance.is_some() {
        description.tolerance = args.tolerance;
        for component in &mut description.components {
            component.tolerance = None;
        }
    }
    if let Some(order) = args.order {
        description.order = match order {
            Order::Sequential => fmu_cosim::Order::Sequential,
            Order::Parallel => fmu_cosim::Order::Parallel,
        };
    }
    if !args.outputs.is_empty() {
        description.outputs.clone_from(&args.outputs);
    }
    if let Some(folder) = &args.fmus {
        description.take_fmus_from(folder);
    }
    Ok(description)
}

fn warn(message: &Message) {
    let Message { instance, text, .. } = message;
    match message.times {
        1 => anstream::eprintln!("{WARNING}warning:{WARNING:#} {instance}: {text}"),
        times => {
            anstream::eprintln!("{WARNING}warning:{WARNING:#} {instance}: {text} ({times} times)")
        }
    }
}

fn report(
    out: &mut impl Write,
    plan: &Plan,
    (time, row): &(f64, Vec<f64>),
    elapsed: Duration,
) -> Result<()> {
    let mut cells = vec![["output".into(), format!("at t = {time} s"), "unit".into()]];
    cells.extend(plan.columns().iter().zip(row).map(|(column, value)| {
        [
            column.name.clone(),
            match column.kind {
                kind if kind.is_float() => format!("{value:.9e}"),
                _ => column.show(*value).to_string(),
            },
            column.unit.clone(),
        ]
    }));
    table::print(&cells, out)?;
    let simulated = plan.end() - plan.experiment().start;
    writeln!(
        out,
        "{simulated:.6} s in {:.3} ms: {}",
        elapsed.as_secs_f64() * 1e3,
        speed(simulated / elapsed.as_secs_f64())
    )?;
    Ok(())
}

/// The speed relative to real time, which may be below 1.
fn speed(factor: f64) -> String {
    let digits = if factor < 10.0 { 2 } else { 0 };
    format!("{factor:.digits$} times real time")
}

/// A progress bar with the simulated time and the speed relative to real time.
struct Progress {
    bar: ProgressBar,
    experiment: Experiment,
    /// The number of rows so far, and of all.
    steps: u64,
    all: u64,
    /// The step of the next update.
    next: u64,
    begin: Instant,
}

impl Progress {
    fn new(experiment: Experiment) -> Result<Self> {
        let all = experiment.steps()?;
        let bar = ProgressBar::new(all);
        bar.set_style(
            ProgressStyle::with_template("[{bar:40}] {percent:>3} %  {msg}  {eta} left")?
                .progress_chars("=> "),
        );
        Ok(Self {
            bar,
            experiment,
            steps: 0,
            all,
            next: 1,
            begin: Instant::now(),
        })
    }

    #[inline]
    fn tick(&mut self, time: f64) {
        self.steps += 1;
        if self.steps == self.next {
            self.update(time);
        }
    }

    #[cold]
    fn update(&mut self, time: f64) {
        let elapsed = self.begin.elapsed().as_secs_f64().max(1e-9);
        let rate = self.steps as f64 / elapsed;
        self.next += 1 + (rate * PERIOD.as_secs_f64()) as u64;
        let stop = self.experiment.stop;
        let speed = speed(rate * self.experiment.step);
        self.bar
            .set_message(format!("t = {time:.3} of {stop} s, {speed}"));
        self.bar.set_position(self.steps);
    }

    /// Whether the last row has been counted.
    #[inline]
    fn is_complete(&self) -> bool {
        self.steps == self.all
    }
}
