//! What an FMU does to the process that runs it, and with the strings and callbacks of the host.

use std::collections::HashSet;
use std::env;
use std::ffi::CString;
use std::fs::{self, DirEntry, symlink_metadata};
use std::hint::black_box;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use fmu_description::{Type, Value};
use fmu_file::text::quote;
use fmu_host::{Treatment, environment, stray_messages};

use super::misuse::provoke;
use crate::binary::rules::{ARITHMETIC, DIRECTORY, ENVIRONMENT, LOADS, LOCALE, SIGNALS};
use crate::binary::run::{Run, SKIP, Setup, Subject, check, lock};
use crate::rule::Rule;

/// A GUID of another FMU.
const WRONG_GUID: &str = "{00000000-0000-0000-0000-000000000000}";

/// Looks for all functions, their version, and creates an instance.
pub fn identity(subject: &Subject<'_>) -> Result<()> {
    let missing = subject.library.missing(subject.kind);
    for name in &missing {
        let text = format!("the function {name} is missing, expected it in the library");
        subject.report.find(&LOADS, text);
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
    let setup = setup.with(|s| s.treatment = Treatment::NoResources);
    let _ = Run::begin(subject, setup);
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
    let misnamed = lock(&subject.logged).misnamed;
    check!(subject, ARGUMENTS_COPIED: misnamed == 0,
        "messages were logged with another name of the instance than the one passed to fmi2Instantiate");
    (subject.observed).ensure_same(&actual, expected, subject.tolerance, [HOW, ""])
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
    let open = |file| symlink_metadata(format!("/proc/self/fd/{file}")).is_ok();
    let is_open = format!("{} and {}", open(1), open(2));
    let arithmetic = match is_arithmetic_usual() {
        true => "usual",
        false => "unusual: numbers are rounded in another way, or subnormal numbers are lost",
    };
    let locale = environment::locale().unwrap_or_default();
    vec![
        (
            &DIRECTORY,
            "the working directory",
            format!("{directory:?}"),
        ),
        (&LOCALE, "the locale", locale),
        (&SIGNALS, "the mask of caught signals", field("SigCgt:")),
        (&ARITHMETIC, "the arithmetic", arithmetic.into()),
        (&ENVIRONMENT, "the umask of new files", field("Umask:")),
        (&ENVIRONMENT, "that stdout and stderr are open", is_open),
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
        (
            "processes",
            tasks.map_or(0, |tasks| tasks.flatten().map(children).sum()),
        ),
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
    let (before, first) = (properties(), handles());
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
            subject.report.find(rule, text);
        }
    }
    let set = env::vars_os().filter(|variable| !variables.contains(variable));
    let set: Vec<_> = set
        .map(|(name, _)| name.to_string_lossy().into_owned())
        .collect();
    check!(subject, ENVIRONMENT: set.is_empty(),
        "the environment variables {} were set in a run", set.join(", "));
    for ((what, old), (_, new)) in between.into_iter().zip(handles()) {
        check!(subject, HANDLES: new <= old,
            "{} {what} are left of an instance that was freed, expected none", new - old);
    }
    Ok(())
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
    Run::recorded(subject, subject.setup().with(|s| s.logging = false))?;
    let chatty = lock(&subject.logged).ok;
    let setup = subject.setup().with(|s| s.logging = true);
    Run::begin(subject, setup)?.advance_by(subject.task.steps.min(20))?;
    provoke(subject, setup);
    // Some FMUs log from their own threads.
    sleep(Duration::from_millis(20));
    let (logged, stray) = (*lock(&subject.logged), stray_messages());
    check!(subject, LOGGING_OFF: chatty == 0,
        "{chatty} messages with status fmi2OK were logged in a run without logging, expected none");
    check!(subject, CATEGORY: logged.uncategorized == 0,
        "{} messages were logged with NULL for the category, expected a category", logged.uncategorized);
    check!(subject, DECLARED_CATEGORY: logged.undeclared == 0,
        "{} messages were logged with a category that LogCategories does not list", logged.undeclared);
    check!(subject, CATEGORY: logged.invalid == 0,
        "{} messages were logged with a status that is not an fmi2Status", logged.invalid);
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
