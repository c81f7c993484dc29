//! What an FMU does to the process that runs it, and with the strings and callbacks of the host.

use std::collections::BTreeMap;
use std::ffi::{CString, OsString};
use std::hint::black_box;
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::Result;
use fmu_description::{Type, Value};
use fmu_file::text::quote;
use fmu_host::{Treatment, environment, stray_messages};

use super::misuse::provoke;
use crate::binary::run::{OrSkip, Run, Setup, Subject, check, report};

/// A GUID of another FMU.
const WRONG_GUID: &str = "{00000000-0000-0000-0000-000000000000}";

/// Looks for all functions, their version, and creates an instance.
pub fn identity(subject: &Subject<'_>) -> Result<()> {
    let missing = subject.library.missing(subject.kind);
    for name in &missing {
        report!(
            subject,
            LOADS,
            "the function {name} is missing, expected it in the library"
        );
    }
    if !missing.is_empty() {
        return Ok(());
    }
    for (function, text) in subject.library.texts()? {
        let expected = match function {
            "fmi2GetTypesPlatform" => "default",
            _ => subject.model.version.as_str(),
        };
        let given = quote(&text);
        check!(subject, VERSION: text == expected, "{function} gave {given}, expected {expected:?}");
    }
    subject.instantiate(&subject.setup())?;
    Ok(())
}

/// Passes the GUID of another FMU.
pub fn guid(subject: &Subject<'_>) -> Result<()> {
    let instance = subject.try_instantiate(&subject.setup(), WRONG_GUID)?;
    check!(subject, GUID: instance.is_none(),
        "fmi2Instantiate accepted the GUID of another FMU, expected NULL: a mismatch of XML and binary \
         would go unnoticed");
    Ok(())
}

/// Frees NULL.
pub fn null(subject: &Subject<'_>) -> Result<()> {
    subject.report.stage("with NULL for the instance");
    subject.library.free_null()?;
    if subject.claims("canGetAndSetFMUstate") {
        let mut run = Run::begin(subject, subject.setup())?;
        subject.report.stage("with NULL for the state");
        run.instance.free_null_state()?;
    }
    Ok(())
}

/// Makes wrong calls, whose messages the FMU cannot log.
pub fn no_logger(subject: &Subject<'_>) -> Result<()> {
    let setup = subject.setup().with(|s| {
        (s.treatment, s.logging) = (Treatment::NoLogger, true);
    });
    subject.report.stage("with a logger that is NULL");
    let _ = subject.try_instantiate(&setup, WRONG_GUID);
    // An FMU may refuse to run without a logger.
    let instance = subject.try_instantiate(&setup, subject.model.token())?;
    if instance.is_some() {
        provoke(subject, setup);
    }
    Ok(())
}

/// Passes no location of the resources, without which an FMU may refuse to run.
pub fn no_resources(subject: &Subject<'_>) -> Result<()> {
    let stage = "with a resource location that is NULL";
    subject.report.stage(stage);
    let setup = subject.setup();
    let _ = Run::begin(
        subject,
        setup.with(|s| s.treatment = Treatment::NoResources),
    );
    Ok(())
}

/// Overwrites the strings that were passed to `fmi2Instantiate`.
pub fn short_lived_strings(subject: &Subject<'_>) -> Result<()> {
    const HOW: &str = "after the strings passed to fmi2Instantiate were overwritten";
    let expected = subject.usual()?;
    let setup = subject.setup().with(|s| {
        (s.treatment, s.logging) = (Treatment::ShortLivedStrings, true);
    });
    subject.report.stage(HOW);
    let actual = Run::recorded(subject, setup)?;
    provoke(subject, setup);
    let tolerance = subject.tolerance();
    if let Some(difference) = subject.observed.difference(&actual, expected, tolerance) {
        report!(subject, ARGUMENTS_COPIED, "{}", difference.told(HOW, ""));
    }
    let misnamed = subject.logged.misnamed.load(Relaxed);
    check!(subject, ARGUMENTS_COPIED: misnamed == 0,
        "messages were logged with another name of the instance than the one passed to fmi2Instantiate");
    Ok(())
}

/// Uses a text for the name of the instance and for Strings.
pub fn with_text(subject: &Subject<'_>, what: &str, text: &str) -> Result<()> {
    let stage = format!("with {what} in the name of the instance and in Strings");
    subject.report.stage(stage);
    let setup = Setup {
        name: text,
        logging: true,
        ..subject.setup()
    };
    provoke(subject, setup);
    let mut run = Run::instantiate(subject, setup).or_skip()?;
    for variable in subject.settable().filter(|v| v.of_type == Type::String) {
        run.set(variable, &[Value::String(text.to_owned())])
            .or_skip()?;
    }
    let _ = run.initialize().and_then(|()| run.advance());
    let _ = run.observe();
    Ok(())
}

struct Process {
    directory: Option<PathBuf>,
    variables: BTreeMap<OsString, OsString>,
    locale: Option<String>,
    /// The signals that are caught, as in `/proc/self/status`.
    signals: Option<String>,
    is_arithmetic_usual: bool,
    umask: Option<String>,
    /// Whether standard output and standard error are open.
    has_output: bool,
    threads: usize,
    children: usize,
    files: usize,
}

impl Process {
    fn now() -> Self {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let field = |name| {
            let value = status.lines().find_map(|line| line.strip_prefix(name));
            value.map(|value| value.trim().to_owned())
        };
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
            signals: field("SigCgt:"),
            is_arithmetic_usual: is_arithmetic_usual(),
            umask: field("Umask:"),
            children: tasks.map_or(0, |tasks| tasks.flatten().map(children).sum()),
            // After the folder of the tasks was closed, which may have taken their numbers.
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
    cycle(subject, subject.task.steps)?;
    let between = Process::now();
    // A trap for invalid operations would end the process here.
    let stage = "which has enabled floating-point traps, as 0/0 in the host";
    subject.report.stage(stage);
    black_box(black_box(0.0_f64) / black_box(0.0_f64));
    subject.report.stage("");
    cycle(subject, subject.task.steps)?;
    let after = settled(between.threads);
    let variables = after.variables.iter();
    let variables = variables.filter(|(name, value)| before.variables.get(*name) != Some(value));
    let variables: Vec<_> = variables.map(|(name, _)| name.to_string_lossy()).collect();
    let is_kept = variables.is_empty();
    let variables = variables.join(", ");
    let path = |of: &Process| match &of.directory {
        Some(path) => path.display().to_string(),
        None => "unknown".into(),
    };
    let [old, new] = [path(&before), path(&after)];
    check!(subject, DIRECTORY: old == new,
        "the working directory is {new} after a run, expected {old} as before");
    check!(subject, ENVIRONMENT: is_kept, "the environment variables {variables} were set in a run");
    let [old, new] = [&before, &after].map(|of| of.locale.clone().unwrap_or_default());
    check!(subject, LOCALE: old == new, "the locale is {new} after a run, expected {old} as before");
    check!(subject, SIGNALS: after.signals == before.signals,
        "signal handlers were installed in a run, expected none");
    check!(subject, ARITHMETIC: after.is_arithmetic_usual == before.is_arithmetic_usual,
        "numbers are rounded in another way after a run, or subnormal numbers are lost");
    check!(subject, ENVIRONMENT: after.umask == before.umask,
        "the permissions of new files (umask) were changed in a run");
    check!(subject, ENVIRONMENT: after.has_output || !before.has_output,
        "standard output or standard error was closed in a run");
    let children = after.children.saturating_sub(before.children);
    check!(subject, HANDLES: children == 0,
        "{children} processes are left of instances that were freed, expected none");
    let threads = after.threads.saturating_sub(between.threads);
    check!(subject, HANDLES: threads == 0,
        "{threads} threads are left of an instance that was freed, expected none");
    let files = after.files.saturating_sub(between.files);
    check!(subject, HANDLES: files == 0,
        "{files} files are left open by an instance that was freed, expected none");
    Ok(())
}

/// The state of the process, once threads have had the time to end.
fn settled(threads: usize) -> Process {
    let begin = Instant::now();
    loop {
        let now = Process::now();
        if now.threads <= threads || begin.elapsed() > Duration::from_millis(500) {
            return now;
        }
        sleep(Duration::from_millis(10));
    }
}

/// Creates and frees instances, between which memory is used again, and one more after a run to the end
/// of the default experiment, since some buffers overflow late.
pub fn lives(subject: &Subject<'_>) -> Result<()> {
    for _ in 0..5 {
        cycle(subject, subject.task.steps)?;
        drop(black_box(vec![1_u8; 1000]));
    }
    let limit = Duration::from_secs(subject.task.seconds) / 2;
    Run::begin(subject, subject.setup())?.run_for(limit, |_, _| {})?;
    Ok(())
}

/// The whole life of an instance.
fn cycle(subject: &Subject<'_>, steps: usize) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    run.advance_by(steps)?;
    run.observe()?;
    if subject.claims("canGetAndSetFMUstate") {
        let state = run.instance.get_fmu_state()?;
        run.instance.set_fmu_state(&state)?;
        run.instance.free_fmu_state(state)?;
    }
    if !run.ended {
        run.instance.terminate()?;
    }
    Ok(())
}

/// Looks for memory that instances do not free.
pub fn memory(subject: &Subject<'_>) -> Result<()> {
    let few = subject.task.steps.min(2);
    let many = few + subject.task.steps.clamp(2, 50);
    let found = |bytes: usize, what: &str, when: &str| {
        check!(subject, MEMORY: bytes == 0,
            "each {what} leaves {bytes} bytes of memory behind{when}, expected none");
    };
    let Some(short) = growth(subject, || cycle(subject, few))? else {
        return Ok(());
    };
    found(short, "instance", "");
    let Some(long) = growth(subject, || cycle(subject, many))? else {
        return Ok(());
    };
    let each = long.saturating_sub(short) / (many - few);
    found(each, "step", " when the instance is freed");
    if subject.claims("canGetAndSetFMUstate") {
        let mut run = Run::begin(subject, subject.setup())?;
        let mut state = run.instance.get_fmu_state()?;
        let save = || Ok(run.instance.save_to(&mut state).map(drop)?);
        let grown = growth(subject, save)?.unwrap_or_default();
        found(grown, "fmi2GetFMUstate that overwrites a state", "");
        run.instance.free_fmu_state(state)?;
    }
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
        if begin.elapsed() > Duration::from_secs(subject.task.seconds) / 4 {
            return Ok(None);
        }
    }
    Ok(Some(least))
}

/// Watches the messages of runs with and without logging, and of mistakes.
pub fn logging(subject: &Subject<'_>) -> Result<()> {
    let logged = &subject.logged;
    Run::recorded(subject, subject.setup().with(|s| s.logging = false))?;
    let chatty = logged.ok.load(Relaxed);
    let setup = subject.setup().with(|s| s.logging = true);
    Run::begin(subject, setup)?.advance_by(subject.task.steps.min(20))?;
    provoke(subject, setup);
    // Some FMUs log from their own threads.
    sleep(Duration::from_millis(20));
    let [without, undeclared, invalid] =
        [&logged.uncategorized, &logged.undeclared, &logged.invalid].map(|n| n.load(Relaxed));
    let stray = stray_messages();
    check!(subject, LOGGING_OFF: chatty == 0,
        "{chatty} messages with status fmi2OK were logged in a run without logging, expected none");
    check!(subject, CATEGORY: without == 0,
        "{without} messages were logged with NULL for the category, expected a category");
    check!(subject, DECLARED_CATEGORY: undeclared == 0,
        "{undeclared} messages were logged with a category that LogCategories does not list");
    check!(subject, CATEGORY: invalid == 0,
        "{invalid} messages were logged with a status that is not an fmi2Status");
    check!(subject, LOG_ENVIRONMENT: stray == 0,
        "{stray} messages were logged with another component environment than an instance's, or \
         after the instance was freed");
    Ok(())
}

/// Selects log categories that do and do not exist.
pub fn debug_logging(subject: &Subject<'_>) -> Result<()> {
    let categories = subject.model.root.list("LogCategories", "Category");
    let mut names: Vec<CString> = categories
        .filter_map(|category| CString::new(category.attribute("name")?).ok())
        .collect();
    let mut run = Run::begin(subject, subject.setup())?;
    if !names.is_empty() {
        run.instance.set_debug_logging(true, &names)?;
    }
    run.instance.set_debug_logging(false, &[])?;
    run.advance()?;
    drop(run);
    let mut run = Run::begin(subject, subject.setup())?;
    subject.report.stage("with an unknown category");
    names.push(CString::from(c"no such category"));
    let _ = run.instance.set_debug_logging(true, &names);
    let _ = run.advance();
    Ok(())
}
