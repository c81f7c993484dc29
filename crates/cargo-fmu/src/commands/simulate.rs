//! Supervisor side of `cargo fmu simulate`: one run of an FMU or of a system of coupled FMUs, in a worker process, since
//! an FMU may crash, hang or exit.

use std::cell::{OnceCell, RefCell};
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use fmu_description::{Type, Value};
use fmu_master::job::{self, Job, SystemSource};
use fmu_master::run::{self, Ready, RunOutcome, SupervisedRun, Watch};
use fmu_master::table::{Format, excerpt, header, is_standard_input, push_line};
use fmu_master::{
    Column, Compilation, Computed, Experiment, FunctionTime, Literal, Message, Observation,
    Overrides, Profile, Row, Statistics,
};
use fmu_worker::{Limits, RealTimeThread};
use indicatif::ProgressBar;

use super::files::stem;
use super::limits::Limited;
use super::over::{self, OtherRun, other_run};
use super::stale;
use crate::plot::{CompleteRun, Drawing, Page};
use crate::progress::{Clock, speed};
use crate::session::{self, Session};
use crate::ui;

/// The FMU or system to simulate, and changes to it.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// FMU, system file such as those in examples/closed-loop, or SSP package
    #[arg(value_name = "FMU or SYSTEM.toml")]
    system: PathBuf,
    #[command(flatten)]
    changes: Overrides,
    /// Write the time and the recorded variables to this file, as Parquet if its name ends in .parquet; - is the
    /// standard output, which then has nothing else
    #[arg(long, value_name = "FILE", value_parser = results)]
    csv: Option<PathBuf>,
    /// How to write the items of enumerations
    #[arg(long, value_enum, value_name = "ITEMS", default_value_t = Items::Names)]
    enumerations: Items,
    #[command(flatten)]
    pub(super) page: Page,
    /// On the page, draw another run, too: of a file, or with other start values, such as controller.pid.kp=250; may be
    /// repeated
    #[arg(long, value_name = "FILE or NAME=VALUE", requires = "file", value_parser = other_run)]
    over: Vec<OtherRun>,
    /// Print what the FMUs log as information, too, of all categories or of these: `--log=logModel` has the messages of
    /// models in Rust
    #[arg(long, value_name = "CATEGORIES", num_args = 0..=1, require_equals = true, value_delimiter = ',')]
    log: Option<Vec<String>>,
    /// Compile FMUs that have C or C++ sources, but no binary for this machine
    #[arg(long)]
    compile: bool,
    #[command(flatten)]
    limited: Limited,
}

/// Performs the run of a job in a worker process, and writes its rows to a file, with names or numbers of items.
///
/// # Errors
/// The run fails, or was interrupted.
pub(super) fn run_to_file(
    job: &Job,
    limits: Limits,
    names_items: bool,
    file: &Path,
    session: &Session,
) -> Result<()> {
    let progress = Progress::new()?;
    let mut command = session::worker()?;
    command.stdout(io::stderr());
    let mut worker = job::start(&mut command, session.folder(), limits, job)?;
    let watch = Watch {
        keeps_rows: false,
        trace: None,
        names_items,
        keeps_worker: false,
        is_cancelled: &|| session.signal().is_some(),
        warn: &ui::warn,
        progress: &|ready, time| progress.show(ready.experiment, time),
        row: &|_, _| {},
        compute: &no_function,
    };
    let outcome = run::supervise(&mut worker, Some(file), &watch)?;
    progress.bar.finish_and_clear();
    match outcome {
        RunOutcome::Finished(_) => Ok(()),
        RunOutcome::Failed { error, .. } => {
            bail!("{error}{}", error.advice.as_ref().map(ui::advice).unwrap_or_default())
        }
        RunOutcome::Cancelled { .. } => bail!("interrupted"),
    }
}

/// How the items of enumerations are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Items {
    /// By their names
    Names,
    /// By their numbers, as FMPy does
    Numbers,
}

/// The file of the results; devices have no ending.
fn results(file: &str) -> Result<PathBuf, &'static str> {
    let file = PathBuf::from(file);
    let is_device = !file.as_os_str().is_empty() && file.extension().is_none();
    let is_table = is_device || Format::from_name(&file).is_some();
    is_table.then_some(file).ok_or("expected a name that ends in .csv or .parquet")
}

/// The arguments of `simulate`, of which `run` has no profile, as its profile is one of cargo.
#[derive(Debug, Args)]
pub struct ProfiledArgs {
    #[command(flatten)]
    simulation: SimulateArgs,
    /// Print where the time went: to each function of each component, and to the master
    #[arg(long)]
    profile: bool,
}

/// Simulates the system in a worker process and reports the results.
///
/// # Errors
/// The system file or the options are invalid, or an FMU returns an error, crashes or hangs.
pub fn run(mut args: ProfiledArgs, out: &mut impl Write) -> Result<ExitCode> {
    args.simulation.changes.observation.profile = args.profile;
    supervise(&args.simulation, &Session::start()?, out)
}

/// Starts a worker process and reports its results.
///
/// # Errors
/// As [`run()`].
pub fn supervise(args: &SimulateArgs, session: &Session, out: &mut impl Write) -> Result<ExitCode> {
    args.check_files()?;
    let fmus = stale::fmus(&args.system, args.changes.fmus.as_deref());
    stale::warn(&fmus);
    let is_printed = args.prints_rows();
    let mut command = session::worker()?;
    let mut messages = anstream::stderr();
    let mut out: &mut dyn Write = if is_printed {
        // What an FMU prints must not get among the rows.
        command.stdout(io::stderr());
        &mut messages
    } else {
        out
    };
    // On a busy machine, too, the rows go out at once.
    let _thread = args.changes.execution.real_time.map(|_| RealTimeThread::enter());
    let printer = RefCell::new(Printer::default());
    let (name, others) = args.other_runs(session)?;
    let others = RefCell::new(others);
    let drawing: OnceCell<RefCell<Drawing>> = OnceCell::new();
    let draw = |ready: &Ready| {
        drawing.get_or_init(|| {
            let (name, others) = (name.clone(), others.take());
            RefCell::new(Drawing::new(name, &ready.columns, &ready.curves, others))
        })
    };
    let limits = args.limited.limits(1)?;
    let mut worker = job::start(&mut command, session.folder(), limits, &args.job())?;
    let progress = Progress::new()?;
    let (rows, has_page) = (args.csv.as_deref().filter(|_| !is_printed), args.page.file.is_some());
    let watch = Watch {
        keeps_rows: rows.is_some(),
        trace: args.changes.observation.trace.as_deref(),
        names_items: args.enumerations == Items::Names,
        keeps_worker: false,
        is_cancelled: &|| session.signal().is_some() || printer.borrow().failure.is_some(),
        warn: &ui::warn,
        progress: &|ready, time| {
            progress.show(ready.experiment, time);
            printer.borrow_mut().flush();
        },
        row: &|ready, row| {
            if is_printed {
                printer.borrow_mut().print(&ready.columns, row);
            }
            if has_page {
                draw(ready).borrow_mut().push(row.time, row.values(&ready.columns));
            }
        },
        compute: &no_function,
    };
    let outcome = run::supervise(&mut worker, rows, &watch)?;
    progress.bar.finish_and_clear();
    printer.into_inner().finish().context("cannot write to the standard output")?;
    match outcome {
        RunOutcome::Finished(finished) => {
            args.print(&finished.completed.messages);
            report(&mut out, &finished)?;
            if let (Some(count), Some(path)) = (finished.rows, rows) {
                writeln!(out, "wrote {}: {}", path.display(), ui::count(count, "row"))?;
            }
            let saved = args.changes.save_state.as_ref();
            if let (Some(path), None) = (saved, &finished.completed.unsaved) {
                writeln!(out, "wrote {}: the state of the run", path.display())?;
            }
            draw(&finished.ready);
            if let Some(drawing) = drawing.into_inner() {
                args.page.draw_runs(&stem(&args.system), || Ok(drawing.into_inner()), &mut out)?;
            }
            if let Some(ended) = finished.crash {
                ui::warn(&format!("after the simulation, the process {ended}"));
            }
            match finished.completed.unsaved {
                Some(reason) => bail!(reason),
                None => Ok(ExitCode::SUCCESS),
            }
        }
        RunOutcome::Failed { error, rows } => {
            args.print(&error.messages);
            let advice = error.advice.as_ref().map(ui::advice).unwrap_or_default();
            bail!("{error}{advice}{}{rows}", stale::advice(&fmus))
        }
        RunOutcome::Cancelled { time, rows } => {
            let time = time.map(|time| format!(" at t = {time:?} s")).unwrap_or_default();
            ui::message(format_args!("interrupted{time}{rows}"));
            Ok(session.signal().map_or(ExitCode::FAILURE, session::code))
        }
    }
}

impl SimulateArgs {
    /// Prints the warnings of FMUs, and the information that the user wants.
    fn print(&self, messages: &[Message]) {
        let is_wanted = |category: &String| {
            self.log.as_ref().is_some_and(|log| log.is_empty() || log.contains(category))
        };
        for message in messages.iter().filter(|m| m.is_problem() || is_wanted(&m.category)) {
            let Message { instance, text, .. } = message;
            let times = match message.times {
                1 => String::new(),
                times => format!(" ({times} times)"),
            };
            let from = if instance.is_empty() { "" } else { ": " };
            let line = format!("{instance}{from}{text}{times}");
            match message.is_problem() {
                true => ui::warn(&line),
                false => ui::message(format_args!("{}: {line}", message.category)),
            }
        }
    }

    /// The name of the run, and the other runs of its page.
    fn other_runs(&self, session: &Session) -> Result<(String, Vec<CompleteRun>)> {
        let (name, names) =
            over::names(&self.system, &self.changes, self.csv.as_deref(), &self.over);
        let runs = self.over.iter().zip(names).enumerate();
        let runs = runs.map(|(number, (run, name))| match run {
            OtherRun::Recorded(file) => CompleteRun::read(name, file),
            OtherRun::Changed(changes) => {
                let file = session.folder().join(format!("over-{number}.csv"));
                let run = self.run_with(changes, &file, session);
                run.with_context(|| format!("--over {name}"))?;
                CompleteRun::read(name, &file)
            }
        });
        Ok((name, runs.collect::<Result<_>>()?))
    }

    /// Runs the system with other start values, and writes the rows to a file.
    fn run_with(
        &self,
        changes: &[(String, Literal)],
        file: &Path,
        session: &Session,
    ) -> Result<()> {
        let mut overrides = Overrides { save_state: None, ..self.changes.clone() };
        overrides.execution.real_time = None;
        overrides.sets.retain(|(set, _)| !changes.iter().any(|(name, _)| name == set));
        overrides.sets.extend_from_slice(changes);
        overrides.observation = Observation::default();
        let names_items = self.enumerations == Items::Names;
        let (limits, job) = (self.limited.limits(1)?, self.job_with(overrides));
        run_to_file(&job, limits, names_items, file, session)
    }

    /// The job of the worker process.
    fn job(&self) -> Job {
        self.job_with(self.changes.clone())
    }

    /// The job of a run with other overrides.
    fn job_with(&self, changes: Overrides) -> Job {
        let (file, sandbox) = (self.system.clone(), self.limited.sandbox());
        let compilation = Compilation { is_wanted: self.compile, cache: None };
        let overrides = Overrides { sandbox, compilation, ..changes };
        let records = self.csv.is_some() || self.page.file.is_some();
        Job::Run { system: SystemSource { file, overrides, ..SystemSource::default() }, records }
    }

    /// Checks before the run what would be found after it.
    fn check_files(&self) -> Result<()> {
        let over = self.over.iter().filter_map(|run| match run {
            OtherRun::Recorded(file) => Some(file),
            OtherRun::Changed(_) => None,
        });
        let input = self.changes.input.iter();
        if input.clone().any(|file| is_standard_input(file)) {
            self.check_standard_input()?;
        }
        let read = input.chain(&self.changes.load_state).chain(over);
        for file in read.filter(|file| !is_standard_input(file)) {
            let read = file.canonicalize();
            let read = read.with_context(|| format!("cannot read {}", file.display()))?;
            let trace = &self.changes.observation.trace;
            let mut written = self.csv.iter().chain(&self.page.file).chain(trace);
            let is_lost = written.any(|file| file.canonicalize().is_ok_and(|file| file == read));
            ensure!(!is_lost, "{} is read, expected another file to write to", file.display());
        }
        self.page.check()
    }

    /// Checks that the standard input can be read, and is read once.
    fn check_standard_input(&self) -> Result<()> {
        ensure!(
            !io::stdin().is_terminal(),
            "--input - is the standard input, which is a terminal, expected a pipe or a file"
        );
        let again = self.over.iter().any(|run| match run {
            OtherRun::Recorded(file) => is_standard_input(file),
            OtherRun::Changed(_) => true,
        });
        ensure!(!again, "--input - is the standard input, which --over cannot read again");
        Ok(())
    }

    /// Whether the rows are printed.
    pub fn prints_rows(&self) -> bool {
        self.csv.as_deref() == Some(Path::new("-"))
    }

    /// The model, unless it is a system file.
    pub fn model(&self) -> Option<String> {
        let is_system = self.system.extension().is_some_and(|extension| extension == "toml");
        (!is_system).then(|| self.system.to_string_lossy().into_owned())
    }

    /// Takes the FMU of the model, or all FMUs of the system, from a folder.
    pub fn use_fmus(&mut self, folder: &Path) {
        match self.model() {
            Some(model) => self.system = folder.join(format!("{model}.fmu")),
            None => self.changes.fmus = Some(folder.to_owned()),
        }
    }
}

/// A system file has no functions, which a supervisor computes.
fn no_function(_: usize, _: f64, _: &[Value]) -> Computed {
    Err("a system file has no functions".to_owned())
}

fn report(out: &mut impl Write, finished: &SupervisedRun) -> Result<()> {
    let (ready, completed) = (&finished.ready, &finished.completed);
    let (columns, time) = (&ready.columns, completed.last.time);
    let last = format!("at t = {} s", Experiment::rounded(time));
    let titles = ["output", "minimum", "maximum", "RMS", &last, "unit"];
    let mut cells = vec![titles.map(str::to_owned)];
    let rows = columns.iter().zip(completed.last.values(columns));
    cells.extend(rows.zip(&completed.summary.statistics).map(|((c, value), statistic)| {
        let short = |number: fn(&Statistics) -> f64| {
            let number = statistic.as_ref().map(number);
            number.map_or_else(String::new, |number| format!("{number:.3e}"))
        };
        let value = match &value {
            None => "absent".to_owned(),
            Some(value) if !c.items.is_empty() => c.named(value.clone()).to_string(),
            Some(Value::Float64(value)) => format!("{value:.9e}"),
            Some(Value::Float32(value)) => format!("{value:.9e}"),
            Some(Value::String(text)) => format!("{text:?}"),
            Some(Value::Binary(bytes)) => excerpt(bytes),
            Some(value) => value.to_string(),
        };
        [
            c.name.clone(),
            short(|s| s.min),
            short(|s| s.max),
            short(|s| s.rms),
            value,
            c.unit.clone(),
        ]
    }));
    for line in ui::lines(&cells, false) {
        writeln!(out, "{line}")?;
    }
    for alarm in completed.summary.sentences() {
        writeln!(out, "{}", ui::wrapped(&format!("alarm: {alarm}")))?;
    }
    for line in ready.notes.iter().map(ui::note).chain(completed.ended.clone()) {
        writeln!(out, "{}", ui::wrapped(&line))?;
    }
    if let Some(steps) = completed.adaptive_steps {
        writeln!(out, "{}", ui::wrapped(&steps.to_string()))?;
    }
    for line in completed.punctuality.iter().flat_map(|punctuality| punctuality.lines()) {
        writeln!(out, "{}", ui::wrapped(&line))?;
    }
    let Experiment { start, step, .. } = ready.experiment;
    // A system that starts at the end of its first step, as a sampled loop may, has that step, too.
    let simulated = if start == step { time } else { time - start };
    let seconds = completed.duration.as_secs_f64();
    let (milliseconds, speed) = (seconds * 1e3, speed(simulated / seconds));
    writeln!(out, "{} s in {milliseconds:.3} ms: {speed}", Experiment::rounded(simulated))?;
    completed.profile.as_ref().map_or(Ok(()), |profile| print_profile(out, profile))
}

/// Prints a table with the time of each function and of the master.
fn print_profile(out: &mut impl Write, profile: &Profile) -> Result<()> {
    let milliseconds = |time: Duration| format!("{:.3}", time.as_secs_f64() * 1e3);
    let microseconds = |time: Duration| format!("{:.3}", time.as_secs_f64() * 1e6);
    let share = |time: Duration| {
        format!("{:.1} %", 100.0 * time.as_secs_f64() / profile.total.as_secs_f64())
    };
    let titles = ["function", "calls", "failed", "total ms", "mean µs", "longest µs", "share"];
    let mut cells = vec![titles.map(str::to_owned)];
    cells.extend(profile.functions.iter().map(|times| {
        let FunctionTime { component, function, calls, failures, total, longest } = times;
        [
            format!("{component}: {function}"),
            calls.to_string(),
            failures.to_string(),
            milliseconds(*total),
            microseconds(times.mean()),
            microseconds(*longest),
            share(*total),
        ]
    }));
    let rest = |name: &str, time| {
        let none = String::new;
        [name.into(), none(), none(), milliseconds(time), none(), none(), share(time)]
    };
    cells.push(rest("master", profile.master()));
    cells.push(rest("total", profile.total));
    for line in ui::lines(&cells, false) {
        writeln!(out, "{line}")?;
    }
    Ok(())
}

/// Prints rows as CSV, until that fails.
#[derive(Default)]
struct Printer {
    text: String,
    has_header: bool,
    failure: Option<io::Error>,
}

/// The length of the text that is collected before it is printed (bytes).
const BUFFER: usize = 1 << 16;

impl Printer {
    fn print(&mut self, columns: &[Column], row: &Row) {
        if !std::mem::replace(&mut self.has_header, true) {
            let time = Column::new("time", "s", Type::Float64);
            let all = [&time].into_iter().chain(columns).cloned();
            self.text = header(&Vec::from_iter(all));
        }
        push_line(&mut self.text, row.cells(columns));
        if self.text.len() >= BUFFER {
            self.flush();
        }
    }

    fn flush(&mut self) {
        let text = std::mem::take(&mut self.text);
        let mut out = io::stdout().lock();
        let printed = out.write_all(text.as_bytes()).and_then(|()| out.flush());
        self.failure = self.failure.take().or(printed.err());
    }

    fn finish(mut self) -> io::Result<()> {
        self.flush();
        self.failure.map_or(Ok(()), Err)
    }
}

/// A progress bar with the simulated time, the speed relative to real time and the time that is left.
struct Progress {
    bar: ProgressBar,
    clock: Clock,
}

/// The length of the bar, the same for any run.
const LENGTH: u64 = 1 << 20;

impl Progress {
    fn new() -> Result<Self> {
        let bar = ProgressBar::new(LENGTH).with_style(ui::bar()?);
        Ok(Self { bar, clock: Clock::default() })
    }

    fn show(&self, experiment: Experiment, time: f64) {
        let (part, text) = self.clock.run(experiment, time);
        self.bar.set_message(text);
        self.bar.set_position((part * LENGTH as f64) as u64);
    }
}
