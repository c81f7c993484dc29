//! `cargo fmu simulate`: one run of a system of coupled FMUs.

use std::io::Write;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use clap::{Args, ValueEnum};
use fmu_cosim::{Csv, Description, Experiment, Failure, Message, Messages, Plan, Value};
use fmu_description::VariableType;
use indicatif::{ProgressBar, ProgressStyle};

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

/// Simulates the system and reports the results.
///
/// # Errors
/// The system file or the options are invalid, or an FMU returns an error.
pub fn run(args: &SimulateArgs, out: &mut impl Write) -> Result<()> {
    let description = describe(args)?;
    let file = || args.system.display().to_string();
    let plan = Plan::new(&description).with_context(file)?;
    let starts = args
        .sets
        .iter()
        .map(|set| plan.start(&set.name, &Value::Text(set.value.clone())))
        .collect::<Result<Vec<_>>>()?;
    let mut csv = match &args.csv {
        Some(path) => Some(Csv::create(path, plan.columns())?),
        None => None,
    };
    let mut progress = Progress::new(plan.experiment())?;
    let mut last = (
        plan.experiment().start,
        vec![f64::NAN; plan.columns().len()],
    );
    let begin = Instant::now();
    let messages = Messages::default();
    let outcome = plan
        .simulate_with(&starts, &messages)
        .and_then(|simulation| {
            simulation.run(|time, row| {
                if let Some(csv) = &mut csv {
                    csv.push(time, row);
                }
                last.0 = time;
                last.1.copy_from_slice(row);
                progress.tick(time);
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
    outcome.map_err(|error| explain(error, csv.is_some()))?;
    let rows = csv.map(Csv::finish).transpose()?;
    report(out, &plan, &last, elapsed)?;
    if let (Some(rows), Some(path)) = (rows, &args.csv) {
        writeln!(out, "wrote {}: {rows} rows", path.display())?;
    }
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

/// Adds to the error of a failed run that its file was not written.
fn explain(error: anyhow::Error, has_file: bool) -> anyhow::Error {
    match error.downcast::<Failure>() {
        Ok(failure) if has_file => anyhow!("{failure}; no file was written"),
        Ok(failure) => failure.into(),
        Err(error) => error,
    }
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
                VariableType::Real => format!("{value:.9e}"),
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
    steps: u64,
    /// The step of the next update.
    next: u64,
    begin: Instant,
}

impl Progress {
    fn new(experiment: Experiment) -> Result<Self> {
        let bar = ProgressBar::new(experiment.steps()?);
        bar.set_style(
            ProgressStyle::with_template("[{bar:40}] {percent:>3} %  {msg}  {eta} left")?
                .progress_chars("=> "),
        );
        Ok(Self {
            bar,
            experiment,
            steps: 0,
            next: 1,
            begin: Instant::now(),
        })
    }

    fn tick(&mut self, time: f64) {
        self.steps += 1;
        if self.steps == self.next {
            let elapsed = self.begin.elapsed().as_secs_f64().max(1e-9);
            let rate = self.steps as f64 / elapsed;
            self.next += 1 + (rate * PERIOD.as_secs_f64()) as u64;
            let stop = self.experiment.stop;
            let speed = speed(rate * self.experiment.step);
            self.bar
                .set_message(format!("t = {time:.3} of {stop} s, {speed}"));
            self.bar.set_position(self.steps);
        }
    }
}
