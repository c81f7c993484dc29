//! What an FMU does to the process that runs it.

use std::collections::BTreeMap;
use std::ffi::{CString, OsString};
use std::hint::black_box;
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::Result;
use fmu_description::Capability::CanGetAndSetFMUstate;
use fmu_host::{environment, stray_messages};

use super::calls::provoke;
use crate::binary::rules::{
    ARITHMETIC, CATEGORY, DECLARED_CATEGORY, DIRECTORY, ENVIRONMENT, HANDLES, LOCALE,
    LOG_ENVIRONMENT, LOGGING_OFF, MEMORY, SIGNALS,
};
use crate::binary::run::Run;
use crate::binary::subject::{Setup, Subject};

/// The state of the process.
struct Process {
    directory: Option<PathBuf>,
    variables: BTreeMap<OsString, OsString>,
    locale: Option<String>,
    /// The signals that are caught, as in `/proc/self/status`.
    signals: Option<String>,
    arithmetic: bool,
    umask: Option<String>,
    threads: usize,
    children: usize,
    files: usize,
    /// Whether standard output and standard error are open.
    has_output: bool,
}

impl Process {
    fn now() -> Self {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let signals = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        let umask = status.lines().find_map(|line| line.strip_prefix("Umask:"));
        let children = |task: std::fs::DirEntry| {
            let text = std::fs::read_to_string(task.path().join("children")).unwrap_or_default();
            text.split_whitespace().count()
        };
        let tasks = std::fs::read_dir("/proc/self/task");
        let open = |file: &str| std::fs::symlink_metadata(format!("/proc/self/fd/{file}")).is_ok();
        let count = |folder| std::fs::read_dir(folder).map_or(0, Iterator::count);
        Self {
            directory: std::env::current_dir().ok(),
            variables: std::env::vars_os().collect(),
            locale: environment::locale(),
            signals: signals.map(|mask| mask.trim().to_owned()),
            arithmetic: is_arithmetic_usual(),
            umask: umask.map(|mask| mask.trim().to_owned()),
            children: tasks.map_or(0, |tasks| tasks.flatten().map(children).sum()),
            has_output: open("1") && open("2"),
            threads: count("/proc/self/task"),
            files: count("/proc/self/fd"),
        }
    }
}

/// Whether numbers are rounded to the nearest and subnormal numbers are kept.
fn is_arithmetic_usual() -> bool {
    let (one, tiny) = (black_box(1.0_f64), black_box(1e-20_f64));
    let nearest = one + tiny == 1.0 && one - tiny == 1.0 && -one - tiny == -1.0;
    let smallest = black_box(f64::MIN_POSITIVE) / black_box(4.0);
    nearest && smallest > 0.0 && smallest * black_box(4.0) == f64::MIN_POSITIVE
}

/// Compares the process before and after the life of two instances.
pub fn process(subject: &Subject<'_>) -> Result<()> {
    // The first instance may set up what all others share.
    let before = Process::now();
    cycle(subject, subject.steps)?;
    let between = Process::now();
    // A trap for invalid operations would end the process here.
    subject
        .report
        .stage("which has enabled floating-point traps, as 0/0 in the host");
    black_box(black_box(0.0_f64) / black_box(0.0_f64));
    subject.report.stage("");
    cycle(subject, subject.steps)?;
    let after = settled(&between);
    let found = |rule, text: String| subject.report.find(rule, text);
    if after.directory != before.directory {
        let path = |d: &Option<PathBuf>| {
            d.as_ref()
                .map_or("unknown".into(), |d| d.display().to_string())
        };
        let (now, then) = (path(&after.directory), path(&before.directory));
        found(
            &DIRECTORY,
            format!("the working directory is {now} after a run, expected {then} as before"),
        );
    }
    let names: Vec<_> = after
        .variables
        .iter()
        .filter(|(name, value)| before.variables.get(*name) != Some(value))
        .map(|(name, _)| name.to_string_lossy())
        .collect();
    if !names.is_empty() {
        found(
            &ENVIRONMENT,
            format!(
                "the environment variables {} were set in a run",
                names.join(", ")
            ),
        );
    }
    if after.locale != before.locale {
        let (now, then) = (
            after.locale.unwrap_or_default(),
            before.locale.unwrap_or_default(),
        );
        found(
            &LOCALE,
            format!("the locale is {now} after a run, expected {then} as before"),
        );
    }
    if after.signals != before.signals {
        found(
            &SIGNALS,
            "signal handlers were installed in a run, expected none".into(),
        );
    }
    if after.arithmetic != before.arithmetic {
        let text = "numbers are rounded in another way after a run, or subnormal numbers are lost";
        found(&ARITHMETIC, text.into());
    }
    if after.umask != before.umask {
        found(
            &ENVIRONMENT,
            "the permissions of new files (umask) were changed in a run".into(),
        );
    }
    if before.has_output && !after.has_output {
        found(
            &ENVIRONMENT,
            "standard output or standard error was closed in a run".into(),
        );
    }
    if after.children > before.children {
        let more = after.children - before.children;
        found(
            &HANDLES,
            format!("{more} processes are left of instances that were freed, expected none"),
        );
    }
    if after.threads > between.threads {
        let more = after.threads - between.threads;
        found(
            &HANDLES,
            format!("{more} threads are left of an instance that was freed, expected none"),
        );
    }
    if after.files > between.files {
        let more = after.files - between.files;
        found(
            &HANDLES,
            format!("{more} files are left open by an instance that was freed, expected none"),
        );
    }
    Ok(())
}

/// The state of the process, once threads have had the time to end.
fn settled(expected: &Process) -> Process {
    let begin = Instant::now();
    loop {
        let now = Process::now();
        if now.threads <= expected.threads || begin.elapsed() > Duration::from_millis(500) {
            return now;
        }
        sleep(Duration::from_millis(10));
    }
}

/// Creates and frees instances, between which memory is used again, and one more after a run to the end
/// of the default experiment, since some buffers overflow late.
pub fn lives(subject: &Subject<'_>) -> Result<()> {
    for _ in 0..5 {
        cycle(subject, subject.steps)?;
        drop(black_box(vec![1_u8; 1000]));
    }
    let mut run = Run::begin(subject, &subject.setup())?;
    run.run_for(subject.all_steps(), subject.time_limit / 2, |_, _| {})?;
    Ok(())
}

/// The whole life of an instance.
fn cycle(subject: &Subject<'_>, steps: usize) -> Result<()> {
    let mut run = Run::begin(subject, &subject.setup())?;
    for _ in 0..steps {
        run.advance()?;
    }
    run.observe()?;
    if subject.claims(CanGetAndSetFMUstate) {
        let state = run.instance.state()?;
        run.instance.set_state(&state)?;
        run.instance.free_state(state)?;
    }
    if !run.ended {
        run.instance.terminate()?;
    }
    Ok(())
}

/// Looks for memory that instances do not free.
pub fn memory(subject: &Subject<'_>) -> Result<()> {
    let few = subject.steps.min(2);
    let many = few + subject.steps.clamp(2, 50);
    let Some(short) = growth(subject, || cycle(subject, few))? else {
        return Ok(());
    };
    let found = |text: String| {
        subject
            .report
            .find(&MEMORY, format!("{text}, expected none"))
    };
    if short > 0 {
        found(format!(
            "each instance leaves {short} bytes of memory behind"
        ));
    }
    let Some(long) = growth(subject, || cycle(subject, many))? else {
        return Ok(());
    };
    let each = long.saturating_sub(short) / (many - few);
    if each > 0 {
        found(format!(
            "each step leaves {each} bytes of memory behind when the instance is freed"
        ));
    }
    if !subject.claims(CanGetAndSetFMUstate) {
        return Ok(());
    }
    let mut run = Run::begin(subject, &subject.setup())?;
    let mut state = run.instance.state()?;
    let grown = growth(subject, || {
        Ok(run.instance.save_to(&mut state).map(drop)?)
    })?;
    if let Some(grown) = grown.filter(|grown| *grown > 0) {
        found(format!(
            "each fmi2GetFMUstate that overwrites a state leaves {grown} bytes of memory behind"
        ));
    }
    run.instance.free_state(state)?;
    Ok(())
}

/// By how much the memory in use grows each time; `None` if that cannot be found out.
fn growth(subject: &Subject<'_>, mut cycle: impl FnMut() -> Result<()>) -> Result<Option<usize>> {
    /// Cycles whose growth is not counted, since they may fill caches.
    const WARM_UP: usize = 4;
    const CYCLES: usize = 8;
    let begin = Instant::now();
    let mut least = usize::MAX;
    for k in 0..WARM_UP + CYCLES {
        let Some(before) = environment::heap() else {
            return Ok(None);
        };
        cycle()?;
        let after = environment::heap().unwrap_or_default();
        if k >= WARM_UP {
            least = least.min(after.saturating_sub(before));
        }
        if begin.elapsed() > subject.time_limit / 4 {
            return Ok(None);
        }
    }
    Ok(Some(least))
}

/// Watches the messages of runs with and without logging, and of mistakes.
pub fn logging(subject: &Subject<'_>) -> Result<()> {
    let silent = Setup {
        logging: false,
        ..subject.setup()
    };
    Run::begin(subject, &silent)?.record(subject.steps)?;
    let chatty = subject.logged.ok.load(Relaxed);
    if chatty > 0 {
        let text = format!(
            "{chatty} messages with status fmi2OK were logged in a run without logging, expected none"
        );
        subject.report.find(&LOGGING_OFF, text);
    }
    let setup = Setup {
        logging: true,
        ..subject.setup()
    };
    let mut run = Run::begin(subject, &setup)?;
    run.record(subject.steps.min(20))?;
    drop(run);
    provoke(subject, &setup);
    let uncategorized = subject.logged.uncategorized.load(Relaxed);
    if uncategorized > 0 {
        let text = format!(
            "{uncategorized} messages were logged with NULL for the category, expected a category"
        );
        subject.report.find(&CATEGORY, text);
    }
    let undeclared = subject.logged.undeclared.load(Relaxed);
    if undeclared > 0 {
        let text = format!(
            "{undeclared} messages were logged with a category that LogCategories does not list"
        );
        subject.report.find(&DECLARED_CATEGORY, text);
    }
    let invalid = subject.logged.invalid.load(Relaxed);
    if invalid > 0 {
        let text =
            format!("{invalid} messages were logged with a status that is not an fmi2Status");
        subject.report.find(&CATEGORY, text);
    }
    // Some FMUs log from their own threads.
    sleep(Duration::from_millis(20));
    let stray = stray_messages();
    if stray > 0 {
        let text = format!(
            "{stray} messages were logged with another component environment than that of an instance, or after the instance was freed"
        );
        subject.report.find(&LOG_ENVIRONMENT, text);
    }
    Ok(())
}

/// Selects log categories that do and do not exist.
pub fn debug_logging(subject: &Subject<'_>) -> Result<()> {
    let categories = subject.model.root.list("LogCategories", "Category");
    let mut names: Vec<CString> = categories
        .filter_map(|category| CString::new(category.attribute("name")?).ok())
        .collect();
    let mut run = Run::begin(subject, &subject.setup())?;
    if !names.is_empty() {
        run.instance.set_debug_logging(true, &names)?;
    }
    run.instance.set_debug_logging(false, &[])?;
    run.advance()?;
    drop(run);
    let mut run = Run::begin(subject, &subject.setup())?;
    subject.report.stage("with an unknown category");
    names.push(CString::from(c"no such category"));
    let _ = run.instance.set_debug_logging(true, &names);
    let _ = run.advance();
    Ok(())
}
