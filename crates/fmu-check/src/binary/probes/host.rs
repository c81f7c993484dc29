//! What an FMU does to the process that runs it, and with the strings and callbacks of the host; calls that hosts
//! must not make, or make only by mistake.

use std::collections::HashSet;
use std::env;
use std::ffi::{CString, OsStr};
use std::fs::{self, DirEntry, symlink_metadata};
use std::hint::black_box;
use std::thread::sleep;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use fmu_description::{Causality, Type, Value, Variability, XmlVariable};
use fmu_file::text::quote;
use fmu_host::{InterfaceType, Treatment, environment, fmi2, stray_messages};

use super::runs::{bytes, reset_and_run};
use crate::binary::FMU;
use crate::binary::run::{Run, SKIP, Setup, Subject, check, lock, readable};
use crate::binary::values::{Difference, is_tested, other};
use crate::rule::{Rule, rule};

/// A GUID of another FMU.
const WRONG_GUID: &str = "{00000000-0000-0000-0000-000000000000}";

/// Looks for all functions, their version, and creates an instance.
pub fn identity(subject: &Subject<'_>) -> Result<()> {
    let missing = subject.library.missing(subject.interface_type);
    for name in &missing {
        let text = format!("the function {name} is missing, expected it in the library");
        subject.report.find(rule!("loads"), text);
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

/// Passes the GUID of another FMU.
pub fn guid(subject: &Subject<'_>) -> Result<()> {
    let instance = subject.try_instantiate(&subject.setup(), WRONG_GUID)?;
    check!(subject, "guid-checked": instance.is_none(),
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
    let setup = Setup { name: text, logging: true, ..subject.setup() };
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
            subject.report.find(rule, text);
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

/// Makes mistakes about which an FMU should log a message, unless it crashes then, which is a finding of
/// its own.
pub fn provoke(subject: &Subject<'_>, setup: Setup<'_>) {
    if !subject.task.is_fragile {
        make_mistakes(subject, setup);
    }
}

/// Finds out whether mistakes crash the FMU.
pub fn mistakes(subject: &Subject<'_>) -> Result<()> {
    make_mistakes(subject, subject.setup());
    Ok(())
}

fn make_mistakes(subject: &Subject<'_>, setup: Setup<'_>) {
    let unknown = unknown(subject);
    let new = || Run::instantiate(subject, setup);
    let _ = new().map(|mut run| run.instance.get_float64(&[unknown], &mut [0.0]));
    let _ = new().map(|mut run| run.instance.do_step(0.0, -1.0));
    let _ = Run::stepped(subject, setup).map(|mut run| run.do_step(1.0, 0.0));
    let _ = new().map(|mut run| {
        let _ = run.initialize();
        run.instance.set_float64(&[unknown], &[0.0])
    });
}

/// A value reference that no variable has.
fn unknown(subject: &Subject<'_>) -> u32 {
    let variables = subject.model.variables();
    let known: HashSet<u32> = variables.map(|(_, v)| v.reference).collect();
    // Not the largest, which may stand for "none".
    let mut candidates = (0..u32::MAX - 7).rev();
    let unknown = candidates.find(|reference| !known.contains(reference));
    unknown.unwrap_or_default()
}

/// Calls that the FMU must refuse.
struct Refused<'a> {
    subject: &'a Subject<'a>,
    accepted: Vec<String>,
}

impl<'a> Refused<'a> {
    fn new(subject: &'a Subject<'a>) -> Self {
        Self { subject, accepted: Vec::new() }
    }

    /// Makes a call in a new run; `what` tells function and circumstances, such as `fmi2DoStep before
    /// initialization`.
    fn call<T, E>(
        &mut self,
        what: impl Into<String>,
        at: impl FnOnce(&'a Subject<'a>, Setup<'a>) -> Result<Run<'a>>,
        call: impl FnOnce(&mut Run<'a>) -> Result<T, E>,
    ) -> Result<()> {
        let what = what.into();
        let circumstances = what.split_once(' ').map_or("", |(_, when)| when);
        self.subject.report.stage(circumstances);
        let mut run = match at(self.subject, self.subject.setup()) {
            Err(error) if error.downcast_ref() == Some(&SKIP) => return Ok(()),
            run => run?,
        };
        if !run.ended && call(&mut run).is_ok() {
            self.accepted.push(what);
        }
        Ok(())
    }

    fn report(self, rule: &Rule) -> Result<()> {
        if !self.accepted.is_empty() {
            let calls = self.accepted.join("; ");
            let text = format!("these calls returned fmi2OK, expected fmi2Error: {calls}");
            self.subject.report.find(rule, text);
        }
        Ok(())
    }
}

/// The types of FMI 2.0 that are accessed with value references that do not exist, by the names of their
/// functions.
const TYPES: [(&str, Type); 3] =
    [("Real", Type::Float64), ("Integer", Type::Int32), ("Boolean", Type::Boolean)];

/// Reads and writes value references that do not exist, and reads those that have another type.
pub fn unknown_references(subject: &Subject<'_>) -> Result<()> {
    let accessed = |v: &XmlVariable<'_>| v.of_type.accessed_as(subject.model.version);
    let variables = || subject.model.variables().map(|(_, v)| v);
    let known: HashSet<_> = variables().map(|v| (accessed(v), v.reference)).collect();
    let unknown = unknown(subject);
    let mut refused = Refused::new(subject);
    for (name, of_type) in TYPES {
        let mut get = |reference: u32, is: &str| {
            let what = format!("fmi2Get{name} for {is}");
            refused.call(what, Run::begin, |run| {
                let mut values = [Value::Boolean(false)];
                (run.instance).get_values(of_type, &[reference], &mut values)
            })
        };
        get(unknown, &format!("the unknown value reference {unknown}"))?;
        let mut seen = HashSet::new();
        let others = variables().filter(|v| {
            let is_other = accessed(v) != of_type && v.of_type != Type::Enumeration;
            is_other && is_tested(v) && !known.contains(&(of_type, v.reference))
        });
        // The first of each type.
        for variable in others.filter(|v| seen.insert(v.of_type)) {
            let is = format!("{}, which has another type", quote(&variable.name));
            get(variable.reference, &is)?;
        }
        let what = format!("fmi2Set{name} for the unknown value reference {unknown}");
        refused.call(what, Run::begin, |run| {
            (run.instance).set_values(of_type, &[unknown], &[Value::Boolean(false)])
        })?;
    }
    refused.report(rule!("unknown-references"))
}

/// Sets what the XML does not allow to set.
pub fn settable(subject: &Subject<'_>) -> Result<()> {
    use Causality::{CalculatedParameter, Local, Output, Parameter};
    use Variability::{Constant, Continuous, Discrete, Fixed};
    // In model exchange, some hosts, such as CasADi, set the states one by one.
    let model = subject.model;
    let variables =
        model.variables().filter(|_| subject.interface_type == InterfaceType::ModelExchange);
    let states: HashSet<u32> = variables
        .filter_map(|(_, v)| Some(model.referred(v.value, "derivative")?.reference))
        .collect();
    let mut refused = Refused::new(subject);
    for (causality, variability, is) in [
        (Output, Continuous, "an output"),
        (Output, Discrete, "an output"),
        (Parameter, Fixed, "a fixed parameter"),
        (Output, Constant, "a constant"),
        (Local, Constant, "a constant"),
        (CalculatedParameter, Fixed, "a calculated parameter"),
    ] {
        let reals = subject.reals(causality);
        let mut reals = reals.into_iter().filter(|v| !states.contains(&v.reference));
        let Some(variable) = reals.find(|v| v.variability == variability) else { continue };
        let value = match causality {
            Parameter => other(variable),
            _ => Some(Value::Float64(0.0)),
        };
        if let Some(value) = value {
            let name = quote(&variable.name);
            let what = format!("fmi2SetReal after initialization for {name}, {is}");
            refused.call(what, Run::stepped, |run| run.set(variable, &[value]))?;
        }
    }
    for variable in subject.settable().filter(|v| v.of_type == Type::Enumeration) {
        let items = variable.items().iter().map(|item| item.value);
        let Some(value) = items.max().and_then(|last| last.checked_add(1)) else { continue };
        let (name, values) =
            (quote(&variable.name), vec![Value::Enumeration(value); variable.element_count()]);
        let what = format!("setting {name} to {value}, which is the value of no item");
        refused.call(what, Run::instantiate, |run| run.set(variable, &values))?;
    }
    refused.report(rule!("settable"))
}

/// Makes calls that the FMU must refuse: what each is, the run in which it is made, and the call.
macro_rules! refuse {
    ($subject:ident, $rule:literal: $($what:literal, $at:expr, $call:expr;)*) => {{
        let mut refused = Refused::new($subject);
        $(refused.call($what, $at, $call)?;)*
        refused.report(rule!($rule))
    }};
}

/// Takes steps with a wrong size or time.
pub fn step_arguments(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, "step-arguments":
        "fmi2DoStep with a negative step size", Run::stepped, |run| run.do_step(1.0, -1.0);
        "fmi2DoStep with a time before the current one", Run::stepped, |run| run.do_step(0.0, 1.0);
        "fmi2DoStep with a time after the current one", Run::stepped, |run| run.do_step(101.0, 1.0);
    }
}

/// Takes steps with invalid numbers.
pub fn step_nan(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, "step-arguments":
        "fmi2DoStep with a step size of NaN", Run::stepped, |run| run.do_step(1.0, f64::NAN);
        "fmi2DoStep with an infinite step size", Run::stepped, |run| run.do_step(1.0, f64::INFINITY);
        "fmi2DoStep with a time of NaN", Run::stepped, |run| run.do_step(f64::NAN, 1.0);
    }
}

/// Makes calls in a wrong order.
pub fn order(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, "order-of-calls":
        "fmi2ExitInitializationMode before fmi2EnterInitializationMode", Run::instantiate,
            |run| run.instance.exit_initialization_mode();
        "fmi2EnterInitializationMode after initialization", Run::stepped,
            |run| run.instance.enter_initialization_mode();
    }
}

/// Sets up the experiment a second time.
pub fn order_of_setup(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, "order-of-calls":
        "fmi2SetupExperiment after initialization", Run::stepped,
            |run| run.instance.setup_experiment(subject.start, None, None);
    }
}

/// Takes steps before initialization and after the end.
pub fn order_of_steps(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, "order-of-calls":
        "fmi2DoStep before initialization", Run::instantiate, |run| run.do_step(0.0, 1.0);
        "fmi2DoStep in initialization mode", Run::initializing, |run| run.do_step(0.0, 1.0);
        "fmi2DoStep after fmi2Terminate", Run::terminated, |run| run.do_step(1.0, 1.0);
    }
}

/// Takes a step beyond the stop time.
pub fn past_stop(subject: &Subject<'_>) -> Result<()> {
    let stop = Some(subject.start + 2.0 * subject.step);
    refuse! { subject, "past-stop-time":
        "fmi2DoStep beyond the stop time",
            |subject, setup| {
                let mut run = Run::stepped(subject, setup.with(|s| s.stop = stop))?;
                run.advance()?;
                Ok(run)
            },
            |run| run.do_step(2.0, 1.0);
    }
}

/// Passes other numbers of values than arrays have.
pub fn array_lengths(subject: &Subject<'_>) -> Result<()> {
    // Also those that cannot be read.
    let none = HashSet::new();
    let arrays = readable(subject.model, &none).filter(|v| !v.dimensions.is_empty());
    let mut refused = Refused::new(subject);
    for variable in arrays.take(4) {
        let n = variable.element_count();
        for wrong in [n + 1, n.saturating_sub(1)] {
            let name = quote(&variable.name);
            let what = format!("reading {wrong} values of {name}, which has {n}");
            refused.call(what, Run::begin, |run| run.read_elements(variable, wrong))?;
        }
    }
    let is_number = |v: &&XmlVariable<'_>| v.of_type != Type::String && !v.start.is_empty();
    for variable in subject.settable().filter(is_number).take(8) {
        let (n, name) = (variable.element_count(), quote(&variable.name));
        for wrong in [n + 1, n - 1] {
            let Some(start) = variable.start_of(0) else { continue };
            let what = format!("setting {wrong} values of {name}, which has {n}");
            let values = vec![start.clone(); wrong];
            refused.call(what, Run::instantiate, |run| run.set(variable, &values))?;
        }
    }
    refused.report(rule!("array-lengths"))
}

/// Passes bytes that are not a serialized state.
pub fn damaged_state(subject: &Subject<'_>) -> Result<()> {
    let sound = bytes(&mut Run::begin(subject, subject.setup())?)?;
    let mut cases: Vec<(String, Vec<u8>)> = vec![
        ("half of a state".into(), sound[..sound.len() / 2].to_vec()),
        ("a state with 8 more bytes".into(), [sound.as_slice(), &[0; 8]].concat()),
        ("255 in all bytes".into(), vec![255; sound.len()]),
    ];
    for at in (0..8).map(|part| part * sound.len() / 8) {
        let mut changed = sound.clone();
        if let Some(byte) = changed.get_mut(at) {
            *byte ^= 0x55;
            cases.push((format!("a state with byte {at} changed"), changed));
        }
    }
    let mut refused = Refused::new(subject);
    for (is, bytes) in cases {
        let what = format!("fmi2SetFMUstate with {is}");
        refused.call(what, Run::begin, |run| {
            let state = run.instance.deserialize_fmu_state(&bytes)?;
            // A copy of memory with pointers is only read when the state is used.
            let set = run.instance.set_fmu_state(&state);
            if set.is_ok() {
                let _ = run.advance();
            }
            let _ = run.instance.free_fmu_state(state);
            set
        })?;
    }
    refused.report(rule!("damaged-state"))
}

/// Steps with NaN for each Real input in turn, of which nothing is left after a reset.
pub fn nan(subject: &Subject<'_>) -> Result<()> {
    with_inputs(subject, &[f64::NAN])?;
    const HOW: &str = "after fmi2Reset of an instance that has received NaN";
    let expected = subject.usual()?;
    let mut run = Run::stepped(subject, subject.setup())?;
    for input in subject.inputs.iter().map(|input| input.variable) {
        if input.of_type == Type::Float64 {
            let _ = run.set(input, &vec![Value::Float64(f64::NAN); input.element_count()]);
        }
    }
    let _ = match subject.interface_type {
        InterfaceType::CoSimulation => run.do_step(1.0, 1.0).map(drop),
        InterfaceType::ModelExchange => run.derivatives().map(drop),
    };
    // Whether an instance can be reset after an error, another test finds.
    ensure!(!subject.library.is_lost(), SKIP);
    let Ok(actual) = reset_and_run(subject, HOW, run) else { return Ok(()) };
    let how = [HOW, " as in a new instance"];
    let differences = subject.observed.differences(&actual, expected, subject.tolerance, how);
    let first = Difference::first(&differences);
    check!(subject, "reset": first.is_none(), "{}", first.map_or("", |first| &first.text));
    Ok(())
}

/// Steps with these values for each Real input in turn.
pub fn with_inputs(subject: &Subject<'_>, values: &[f64]) -> Result<()> {
    let inputs = subject.inputs.iter().map(|input| input.variable);
    let inputs = inputs.filter(|v| v.of_type == Type::Float64).take(10);
    for (input, value) in inputs.flat_map(|input| values.iter().map(move |value| (input, *value))) {
        subject.report.stage("");
        let mut run = Run::stepped(subject, subject.setup())?;
        let name = quote(&input.name);
        subject.report.stage(format!("with {name} = {value}"));
        if run.set(input, &vec![Value::Float64(value); input.element_count()]).is_err() {
            continue;
        }
        // The run sets its inputs itself, so steps are taken without it.
        if subject.interface_type == InterfaceType::CoSimulation {
            let _ = (1..4).try_for_each(|k| run.do_step(f64::from(k), 1.0).map(drop));
        } else if subject.states > 0 {
            let _ = run.derivatives();
        }
        if !run.ended {
            let _ = run.observe();
        }
    }
    Ok(())
}

/// Resets an instance after an error.
pub fn after_error(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::stepped(subject, subject.setup())?;
    let unknown = unknown(subject);
    let refused = run.instance.get_float64(&[unknown], &mut [0.0]).is_err();
    if !refused || subject.library.is_lost() {
        return Ok(());
    }
    subject.report.stage("after fmi2Error and fmi2Reset");
    run.instance.reset().context("after fmi2Error")?;
    run.initialize()?;
    run.advance()
}

/// Asks for the status of steps, and cancels one, though no step is asynchronous.
pub fn status(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::stepped(subject, subject.setup())?;
    let (mut time, mut status, mut text) = (0.0, fmi2::fmi2OK, std::ptr::null());
    let i = &mut run.instance;
    let _ = i.is_terminated();
    let has_time = i.get_real_status(fmi2::fmi2LastSuccessfulTime, &mut time).is_ok();
    let _ = i.get_status(fmi2::fmi2DoStepStatus, &mut status);
    let _ = i.get_string_status(fmi2::fmi2PendingStatus, &mut text);
    let _ = i.cancel_step();
    let end = run.time();
    check!(subject, "last-time-status": !has_time || (time - end).abs() <= 1e-6 * subject.step,
        "fmi2LastSuccessfulTime is {time} s after a step to t = {end} s, expected the end of the step");
    Ok(())
}
