//! What an FMU does to the process that runs it, and with the strings and callbacks of the host.

use std::collections::HashSet;
use std::env;
use std::ffi::{CString, OsStr};
use std::fs::{self, DirEntry, symlink_metadata};
use std::hint::black_box;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use fmu_description::{Type, Value};
use fmu_file::text::quote;
use fmu_host::{Treatment, environment, stray_messages};

use super::misuse::{WRONG_GUID, provoke};
use crate::binary::report::{check, lock};
use crate::binary::run::Run;
use crate::binary::subject::{RunSetup, SKIP, Subject};
use crate::binary::task::FMU;
use crate::rule::{Rule, rule};

/// Looks for all functions, their version, and creates an instance.
pub fn identity(subject: &Subject<'_>) -> Result<()> {
    let missing = subject.library.missing(subject.interface_type);
    for name in &missing {
        let text = format!("the function {name} is missing, expected it in the library");
        subject.report.add_finding(rule!("loads"), text);
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
        check!(subject, "version-functions": text == expected, "{function} gave {given}, expected {expected:?}");
    }
    subject.instantiate(&subject.setup())?;
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
    let setup = setup.with(|s| s.treatment = Treatment::NoResources);
    let _ = Run::begin(subject, setup);
    Ok(())
}

/// Counts the memory that an FMU gets from the host, though it says that it does not.
pub fn memory_functions(subject: &Subject<'_>) -> Result<()> {
    let before = fmu_host::allocations();
    let mut run = Run::begin(subject, subject.setup())?;
    run.advance()?;
    let calls = fmu_host::allocations() - before;
    ensure!(calls == 0, "calls of allocateMemory: {calls}, expected none");
    Ok(())
}

/// Passes a location of the resources with spaces and percent signs.
pub fn resource_path(subject: &Subject<'_>) -> Result<()> {
    const HOW: &str = "with resources in a folder whose name has spaces and percent signs";
    let fmu = subject.task.session.join(FMU);
    if fs::read_dir(fmu.join("resources"))?.next().is_none() {
        return Ok(());
    }
    let expected = subject.usual()?;
    let folder = tempfile::Builder::new().prefix("a b %20c ").tempdir_in(&subject.task.session)?;
    // A link, so that what is beside the resources is found, too.
    let link = folder.path().join(FMU);
    #[cfg(unix)]
    let linked = std::os::unix::fs::symlink(&fmu, &link);
    #[cfg(windows)]
    let linked = std::os::windows::fs::symlink_dir(&fmu, &link);
    linked.ok().context(SKIP)?;
    subject.report.stage(HOW);
    let moved = subject.with_resources(&link.join("resources"))?;
    let actual = Run::recorded(&moved, moved.setup())?;
    (subject.observed).ensure_same(&actual, expected, subject.tolerance, [HOW, ""])
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
    let misnamed = lock(&subject.logged).misnamed;
    check!(subject, "arguments-copied": misnamed == 0,
        "messages were logged with another name of the instance than the one passed to fmi2Instantiate");
    (subject.observed).ensure_same(&actual, expected, subject.tolerance, [HOW, ""])
}

/// Uses a text for the name of the instance and for Strings.
pub fn with_text(subject: &Subject<'_>, what: &str, text: &str) -> Result<()> {
    let stage = format!("with {what} in the name of the instance and in Strings");
    subject.report.stage(stage);
    let setup = RunSetup { name: text, logging: true, ..subject.setup() };
    provoke(subject, setup);
    let mut run = Run::instantiate(subject, setup).ok().context(SKIP)?;
    for variable in subject.settable().filter(|v| v.of_type == Type::String) {
        let set = run.set(variable, &[Value::String(text.to_owned())]);
        set.ok().context(SKIP)?;
    }
    let _ = run.initialize().and_then(|()| run.advance());
    let _ = run.observe();
    Ok(())
}

/// A property of the process: the rule that a change breaks, its name, and its value.
type Property = (&'static Rule, &'static str, String);

/// What runs must leave as it is.
fn properties() -> Vec<Property> {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let field = |name| {
        let value = status.lines().find_map(|line| line.strip_prefix(name));
        value.unwrap_or_default().trim().to_owned()
    };
    let directory = env::current_dir().unwrap_or_default();
    let state = |file| match symlink_metadata(format!("/proc/self/fd/{file}")) {
        Ok(_) => "open",
        Err(_) => "closed",
    };
    let output = format!("{} and {}", state(1), state(2));
    let locale = environment::locale().unwrap_or_default();
    vec![
        (rule!("working-directory"), "the working directory", format!("{directory:?}")),
        (rule!("locale"), "the locale", locale),
        (rule!("signals"), "the mask of caught signals", field("SigCgt:")),
        (rule!("signals"), "the mask of ignored signals", field("SigIgn:")),
        (rule!("environment"), "the umask of new files", field("Umask:")),
        (rule!("environment"), "the state of stdout and stderr", output),
    ]
}

/// How many of its processes, threads and files there are.
fn handles() -> [(&'static str, usize); 3] {
    let children = |task: DirEntry| {
        let text = fs::read_to_string(task.path().join("children")).unwrap_or_default();
        text.split_whitespace().count()
    };
    let tasks = fs::read_dir("/proc/self/task");
    let count = |folder| fs::read_dir(folder).map_or(0, Iterator::count);
    [
        ("processes", tasks.map_or(0, |tasks| tasks.flatten().map(children).sum())),
        ("threads", count("/proc/self/task")),
        ("open files", count("/proc/self/fd")),
    ]
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
    let (before, first, was_usual) = (properties(), handles(), is_arithmetic_usual());
    let variables: HashSet<_> = env::vars_os().collect();
    cycle(subject, subject.task.steps)?;
    // The first instance may set up what all others share, but start no process.
    let mut between = handles();
    between[0] = first[0];
    // A trap for invalid operations would end the process here.
    let stage = "which has enabled floating-point traps, as 0/0 in the host";
    subject.report.stage(stage);
    black_box(black_box(0.0_f64) / black_box(0.0_f64));
    subject.report.stage("");
    cycle(subject, subject.task.steps)?;
    // Threads need time to end.
    let begin = Instant::now();
    while handles()[1] > between[1] && begin.elapsed() < Duration::from_millis(500) {
        sleep(Duration::from_millis(10));
    }
    for ((rule, what, old), (_, _, new)) in before.into_iter().zip(properties()) {
        if old != new {
            let text = format!("{what} is {new} after a run, expected {old} as before");
            subject.report.add_finding(rule, text);
        }
    }
    check!(subject, "arithmetic": is_arithmetic_usual() == was_usual,
        "the floating-point mode has changed in a run (rounding, or subnormal numbers flushed to \
         zero), expected it unchanged");
    let set = env::vars_os().filter(|variable| !variables.contains(variable));
    let set: Vec<_> = set.map(|(name, _)| name).collect();
    check!(subject, "environment": set.is_empty(),
        "the environment variables {} were set in a run", set.join(OsStr::new(", ")).display());
    for ((what, old), (_, new)) in between.into_iter().zip(handles()) {
        check!(subject, "handles": new <= old,
            "{} {what} are left of an instance that was freed, expected none", new - old);
    }
    Ok(())
}

/// Creates and frees instances, between which memory is used again, and one more after a run to the end
/// of the default experiment, since some buffers overflow late.
pub fn lives(subject: &Subject<'_>) -> Result<()> {
    subject.report.stage("with an allocator that checks the heap");
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
    if run.ended {
        return Ok(());
    }
    run.observe()?;
    if subject.claims("canGetAndSetFMUstate") {
        let state = run.instance.get_fmu_state()?;
        run.instance.set_fmu_state(&state)?;
        run.instance.free_fmu_state(state)?;
    }
    run.instance.terminate()?;
    Ok(())
}

/// Looks for memory that instances do not free.
pub fn memory(subject: &Subject<'_>) -> Result<()> {
    /// How often the growth must increase with the number of steps, since the allocator keeps memory for later, and
    /// an FMU may fill a cache.
    const WINDOWS: usize = 3;
    let few = subject.task.steps.min(2);
    let more = subject.task.steps.clamp(2, 50);
    let found = |bytes: usize, what: &str, when: &str| {
        check!(subject, "memory": bytes == 0,
            "each {what} leaves {bytes} bytes of memory behind{when}, expected none");
    };
    let short = growth(subject, || cycle(subject, few))?;
    found(short, "instance", "");
    let (mut each, mut before) = (usize::MAX, short);
    for window in 1..=WINDOWS {
        let after = growth(subject, || cycle(subject, few + window * more))?;
        each = each.min(after.saturating_sub(before) / more);
        if each == 0 {
            break;
        }
        before = after;
    }
    found(each, "step", " when the instance is freed");
    let mut run = Run::begin(subject, subject.setup())?;
    let grown = growth(subject, || {
        run.instance.reset()?;
        run.initialize()?;
        run.advance_by(few)
    })?;
    found(grown, "fmi2Reset", "");
    if subject.claims("canGetAndSetFMUstate") {
        let mut run = Run::begin(subject, subject.setup())?;
        let mut state = run.instance.get_fmu_state()?;
        let grown = growth(subject, || Ok(run.instance.save_to(&mut state).map(drop)?))?;
        found(grown, "fmi2GetFMUstate that overwrites a state", "");
        run.instance.free_fmu_state(state)?;
    }
    Ok(())
}

/// By how much the memory in use grows each time; the test ends if that cannot be found out.
fn growth(subject: &Subject<'_>, mut cycle: impl FnMut() -> Result<()>) -> Result<usize> {
    /// Cycles whose growth is not counted, since they may fill caches.
    const WARM_UP: usize = 4;
    const CYCLES: usize = 8;
    let limit = Duration::from_secs(subject.task.seconds) / 4;
    let begin = Instant::now();
    let mut least = usize::MAX;
    for k in 0..WARM_UP + CYCLES {
        let before = environment::heap().context(SKIP)?;
        cycle()?;
        let after = environment::heap().context(SKIP)?;
        if k >= WARM_UP {
            least = least.min(after.saturating_sub(before));
        }
        ensure!(begin.elapsed() <= limit, SKIP);
    }
    Ok(least)
}

/// Watches the messages of runs with and without logging, and of mistakes.
pub fn logging(subject: &Subject<'_>) -> Result<()> {
    Run::recorded(subject, subject.setup().with(|s| s.logging = false))?;
    let chatty = lock(&subject.logged).ok;
    let setup = subject.setup().with(|s| s.logging = true);
    Run::begin(subject, setup)?.advance_by(subject.task.steps.min(20))?;
    provoke(subject, setup);
    // Some FMUs log from their own threads.
    sleep(Duration::from_millis(20));
    let (logged, stray) = (*lock(&subject.logged), stray_messages());
    check!(subject, "logging-off": chatty == 0,
        "messages with status fmi2OK in a run without logging: {chatty}, expected none");
    check!(subject, "log-category": logged.uncategorized == 0,
        "messages with NULL for the category: {}, expected none", logged.uncategorized);
    check!(subject, "log-category-declared": logged.undeclared == 0,
        "messages with a category that LogCategories does not list: {}, expected none", logged.undeclared);
    check!(subject, "log-category": logged.invalid == 0,
        "messages with a status that is not an fmi2Status: {}, expected none", logged.invalid);
    check!(subject, "log-environment": stray == 0,
        "messages with another component environment than an instance's, or after the instance was \
         freed: {stray}, expected none");
    Ok(())
}

/// Selects log categories that do and do not exist.
pub fn debug_logging(subject: &Subject<'_>) -> Result<()> {
    let categories = subject.model.root.list("LogCategories", "Category");
    let mut names: Vec<CString> =
        categories.filter_map(|category| CString::new(category.attribute("name")?).ok()).collect();
    let mut run = Run::begin(subject, subject.setup())?;
    if !names.is_empty() {
        run.instance.set_debug_logging(true, &names)?;
    }
    run.instance.set_debug_logging(false, &[])?;
    let before = lock(&subject.logged).ok;
    run.advance_by(subject.task.steps.min(20))?;
    drop(run);
    let logged = lock(&subject.logged).ok - before;
    check!(subject, "logging-off": logged == 0,
        "messages with status fmi2OK after fmi2SetDebugLogging(false): {logged}, expected none");
    // All of them include the others.
    for name in names.iter().filter(|name| !name.as_bytes().ends_with(b"All")).take(5) {
        let mut run = Run::begin(subject, subject.setup())?;
        if run.instance.set_debug_logging(true, std::slice::from_ref(name)).is_ok() {
            *lock(&subject.chosen) = Some(name.to_string_lossy().into_owned());
            run.advance_by(subject.task.steps.min(20))?;
            *lock(&subject.chosen) = None;
        }
    }
    let unchosen = lock(&subject.logged).unchosen;
    check!(subject, "log-categories": unchosen == 0,
        "messages with status fmi2OK and a category that was not chosen: {unchosen}, expected none");
    let mut run = Run::begin(subject, subject.setup())?;
    subject.report.stage("with an unknown category");
    names.push(CString::from(c"no such category"));
    let _ = run.instance.set_debug_logging(true, &names);
    let _ = run.advance();
    Ok(())
}
