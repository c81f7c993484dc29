//! The tests of a binary. Each runs in a process of its own.

mod host;
mod interfaces;
mod regions;
mod runs;
mod steps;
mod values;

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use fmu_description::xml::{self, Element};
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_host::Library;
use fmu_worker::Service;

use super::run::{ONLY_ONCE, Report, Run, SKIP, Setup, Subject, claims, is_refusal};
use super::values::Trajectory;
use super::{FMU, Reply, Task};
use crate::rule::{Rule, rule};

/// A test.
pub struct Probe {
    pub name: &'static str,
    /// The rule that it breaks if it fails.
    pub rule: &'static Rule,
    /// The error is a finding.
    test: fn(&Subject<'_>) -> Result<()>,
    /// What else is to know about it.
    traits: &'static [Trait],
}

/// What is special about a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trait {
    /// It is one of the quick tests.
    Quick,
    /// Its calls are those that hosts must not make; if they crash, that is no error of the FMU.
    Misuse,
    /// If the process crashes, hangs or ends, that breaks the same rule.
    Own,
    /// It takes a few seconds at most.
    Brief,
    /// The library is unloaded before the test ends.
    Unloads,
    /// It is for co-simulation, or for model exchange.
    CoSimulation,
    ModelExchange,
    /// It is for one version of FMI.
    Fmi2,
    Fmi3,
    /// A process may have several instances.
    Several,
    /// The FMU declares this flag, named as in FMI 2.0.
    Claims(&'static str),
}
use Trait::{
    Brief, Claims, CoSimulation, Fmi2, Fmi3, Misuse, ModelExchange, Own, Quick, Several, Unloads,
};

impl Probe {
    /// The test of a name.
    pub fn named(name: &str) -> Result<&'static Self> {
        let mut all = [FIRST, INSTANCES, MISTAKES, OTHERS].into_iter().flatten();
        all.find(|probe| probe.name == name).context("there is no such test")
    }

    pub fn is_quick(&self) -> bool {
        self.traits.contains(&Quick)
    }

    /// Whether its calls are those that hosts must not make.
    pub fn is_misuse(&self) -> bool {
        self.traits.contains(&Misuse)
    }

    /// The rule that it breaks if the process crashes, hangs or ends.
    pub fn crash(&self) -> &'static Rule {
        match self.traits {
            _ if self.is_misuse() => rule!("survives-misuse"),
            traits if traits.contains(&Own) => self.rule,
            _ => rule!("survives"),
        }
    }

    /// Its time limit in seconds, given the usual one.
    pub fn seconds(&self, usual: u64) -> u64 {
        const FEW: u64 = 5;
        match self.is_misuse() || self.traits.contains(&Brief) {
            true => usual.min(FEW),
            false => usual,
        }
    }

    /// Whether it is for an interface type of an FMU, given by its element; `is_alone` tells that a process may have one
    /// instance only.
    pub fn applies(&self, element: &Element<'_>, version: FmiVersion, is_alone: bool) -> bool {
        self.traits.iter().all(|needed| match needed {
            CoSimulation => element.name == "CoSimulation",
            ModelExchange => element.name == "ModelExchange",
            Fmi2 => version == FmiVersion::Fmi2,
            Fmi3 => version == FmiVersion::Fmi3,
            Several => !is_alone,
            Claims(flag) => claims(element, flag, version),
            _ => true,
        })
    }

    /// What the FMU declares, if the test is about that.
    fn claim(&self) -> Option<String> {
        self.traits.iter().rev().find_map(|about| match about {
            Claims(flag) => Some(format!("{flag} is true, but")),
            Several => Some(format!("{ONLY_ONCE} is false, but")),
            _ => None,
        })
    }

    /// Runs it, in the child process.
    fn run(&self, subject: &Subject<'_>) -> Result<()> {
        match ((self.test)(subject), self.claim()) {
            (Err(error), _) if error.downcast_ref() == Some(&SKIP) => Ok(()),
            (Err(error), _) if subject.needs_ticks && is_refusal(&error) => {
                let text = format!("not tested, since its clocks do not tick: {error:#}");
                subject.report.find(rule!("not-tested"), text);
                Ok(())
            }
            (Err(error), Some(claim)) => Err(error.context(claim)),
            (outcome, _) => outcome,
        }
    }
}

/// Makes a run that must be the same as the usual run, up to this relative difference. `how` tells what is
/// different, such as `after fmi2Reset`, which `run` receives, and what the usual run has done.
fn same(
    subject: &Subject<'_>,
    how: [&str; 2],
    tolerance: f64,
    run: impl FnOnce(&Subject<'_>, &str) -> Result<Trajectory>,
) -> Result<()> {
    let expected = subject.usual()?;
    let actual = run(subject, how[0])?;
    (subject.observed).ensure_same(&actual, expected, tolerance, how)
}

/// As [`same`], for a run with a change of its setup.
fn same_with(
    subject: &Subject<'_>,
    how: [&str; 2],
    tolerance: f64,
    change: impl FnOnce(&mut Setup<'_>),
) -> Result<()> {
    same(subject, how, tolerance, |subject, how| {
        subject.report.stage(how);
        Run::recorded(subject, subject.setup().with(change))
    })
}

/// Receives a test of a binary in this process, which [`crate::Probes`] has started, and runs it.
///
/// # Errors
/// The process was not started for a test, or the unpacked FMU cannot be read.
pub fn run() -> Result<()> {
    // A dump of memory in the working directory would count as a file of the FMU.
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, setrlimit};
        let _ = setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) });
    }
    let service = Service::from_env()?;
    let mut service = service.context("it is started by `validate` only")?;
    let task: Task = service.task()?.context("there is no test to run")?;
    let text = std::fs::read_to_string(task.session.join(MODEL_DESCRIPTION))?;
    let root = xml::parse(&text)?;
    let model = ModelDescription::read(&root)?;
    let report = Arc::new(Report::new(service, model.version, task.interface_type()));
    let probe = Probe::named(&task.probe)?;
    let folder = task.session.join(FMU);
    let trace = Arc::clone(&report);
    let call = move |name| trace.call(name);
    let library = Library::load_traced(&folder.join(&task.binary), model.version, call);
    let outcome = match &library {
        Ok(library) => {
            let subject = Subject::new(&task, &model, library, &report);
            subject.and_then(|subject| probe.run(&subject))
        }
        Err(error) => Err(error.clone().into()),
    };
    if let Err(error) = outcome {
        // The folder no longer exists when the message is read.
        let text = format!("{error:#}").replace(&format!("{}/", folder.display()), "");
        match lacking(&text).filter(|name| !is_in(&folder, name)) {
            Some(name) if library.is_err() => {
                let text = format!("this machine lacks {name}, which it needs; no binary was run");
                report.find(rule!("binary-not-run"), text);
            }
            _ => report.fail(probe.rule, &text),
        }
    }
    report.reply(&Reply::Tested);
    if probe.traits.contains(&Unloads) {
        settle();
        drop(library);
    }
    report.reply(&Reply::Done);
    Ok(())
}

/// The library, or the version of one, for want of which another cannot be loaded, from the message of the dynamic
/// loader of Linux.
fn lacking(text: &str) -> Option<&str> {
    let text = text.rsplit_once("cannot be loaded: ").map_or(text, |(_, reason)| reason);
    if let Some((name, _)) = text.split_once(": cannot open shared object file") {
        return Some(name);
    }
    let (_, version) = text.split_once(": version `")?;
    version.split_once("' not found").map(|(version, _)| version)
}

/// Whether a folder or one in it has a file of this name.
fn is_in(folder: &Path, name: &str) -> bool {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).any(|path| path.ends_with(name) || is_in(&path, name))
}

#[test]
fn a_library_that_the_machine_lacks_is_named() {
    let lacks =
        "it cannot be loaded: libgfortran.so.3: cannot open shared object file: No such file";
    assert_eq!(lacking(lacks), Some("libgfortran.so.3"));
    let old =
        "it cannot be loaded: /lib/libc.so.6: version `GLIBC_2.99' not found (required by a.so)";
    assert_eq!(lacking(old), Some("GLIBC_2.99"));
    assert_eq!(lacking("it cannot be loaded: a.so: undefined symbol: f"), None);
}

/// Gives threads that the FMU has left behind the time to end or to wait, since a library whose code runs
/// cannot be unloaded.
fn settle() {
    const USUAL: usize = 2;
    let threads = std::fs::read_dir("/proc/self/task").map_or(0, Iterator::count);
    if threads > USUAL {
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// Defines tests: the name of each, the rule that it breaks if it fails, its function and traits.
macro_rules! probes {
    ($($name:literal: $rule:literal, $test:expr $(, $trait:expr)*;)*) => {
        &[$(Probe {
            name: $name,
            rule: rule!($rule),
            test: $test,
            traits: &[$($trait),*],
        }),*]
    };
}

/// The rounding of vectorized loops.
const ROUNDING: f64 = 1e-9;
/// The error of other step sizes, but for the solver's.
const COARSE: f64 = 1e-3;

/// The tests on whose results the others depend.
static FIRST: &[Probe] = probes! {
    // The binary loads and creates an instance.
    "identity": "loads", host::identity, Unloads;
    // Which variables cannot be read.
    "readable": "runs", values::readable;
    // A run to the end of the default experiment.
    "experiment": "runs", runs::experiment;
    // Short runs, which are compared between processes.
    "trace": "runs", |s| runs::trace(s, s.setup());
    "trace-logging": "independent-of-host",
        |s| runs::trace(s, s.setup().with(|s| (s.name, s.logging) = ("another_name", true)));
    // The life of an instance under an allocator that checks the heap. What is no crash, another test finds.
    "heap": "heap", |s| host::lives(s).ok().context(SKIP), Own;
};

const STATE: Trait = Claims("canGetAndSetFMUstate");
const BYTES: Trait = Claims("canSerializeFMUstate");
const DIRECTIONAL: Trait = Claims("providesDirectionalDerivative");
const ADJOINT: Trait = Claims("providesAdjointDerivatives");
const INTERPOLATES: Trait = Claims("canInterpolateInputs");
const VARIABLE_STEPS: Trait = Claims("canHandleVariableCommunicationStepSize");
const NEW: &str = " as in a new instance";
const ALONE: &str = " as alone";
const STOP: &str = " as with the stop time of the default experiment";
const WHOLE: &str = " as with whole steps";

/// Whether instances share state; other tests then make one in each process.
pub static INSTANCES: &[Probe] = probes! {
    "instances": "separate-instances", |s| same(s, ["with a second instance", ALONE], ROUNDING, runs::beside), Quick, Several;
    "previous": "separate-instances",
        |s| same(s, ["after another instance was freed", ALONE], ROUNDING, runs::after_another), Quick, Several;
};

/// Calls that hosts make by mistake; other tests make none if these crash.
pub static MISTAKES: &[Probe] = probes! {
    "mistakes": "survives-misuse", host::mistakes, Misuse;
    "unknown": "unknown-references", host::unknown_references, Misuse;
    "step-arguments": "step-arguments", host::step_arguments, Misuse, CoSimulation;
    "order": "order-of-calls", host::order, Misuse;
    "order-of-setup": "order-of-calls", host::order_of_setup, Misuse, Fmi2;
    "order-of-steps": "order-of-calls", host::order_of_steps, Misuse, CoSimulation;
};

/// All other tests.
pub static OTHERS: &[Probe] = probes! {
    "guid": "guid-checked", host::guid, Quick;
    "start": "start-values", values::start, Quick;
    "state": "state", runs::restore, Quick, STATE;
    "serialized": "serialized-state", runs::serialize, Quick, STATE, BYTES;
    "directional": "directional-derivatives", values::derivatives_in_run, Quick, DIRECTIONAL;
    "directional-elsewhere": "directional-derivatives", regions::derivatives, DIRECTIONAL;
    "dependencies-kind": "dependencies-kind", regions::kinds;
    "directional-initial": "directional-derivatives", values::derivatives_in_initialization, DIRECTIONAL;
    "directional-unlisted": "directional-derivatives", values::unlisted_derivatives, Misuse, DIRECTIONAL;
    "input-derivatives": "input-derivatives", values::derivatives_of_inputs_in_time,
        Quick, Fmi2, CoSimulation, INTERPOLATES;
    "output-derivatives": "output-derivatives", values::derivatives_of_outputs_in_time, Quick, CoSimulation;
    "reset": "reset", |s| same(s, ["after fmi2Reset", NEW], s.tolerance, runs::reset), Quick;
    "reset-new": "reset",
        |s| same(s, ["after fmi2Reset of a new instance", NEW], s.tolerance,
            |s, how| runs::reset_and_run(s, how, Run::instantiate(s, s.setup())?));
    "reset-initializing": "reset",
        |s| same(s, ["after fmi2Reset in initialization mode", NEW], s.tolerance,
            |s, how| runs::reset_and_run(s, how, Run::initializing(s, s.setup())?));
    "reset-values": "reset", runs::reset_values;
    "thread": "any-thread", |s| same(s, ["on another thread", ALONE], ROUNDING, runs::on_a_thread);
    "threads": "any-thread", runs::on_threads, Own, Several;
    "strings-of-instances": "string-lifetime", values::strings_of_instances, Several;
    "no-stop-time": "independent-of-stop-time",
        |s| same_with(s, ["without a stop time", STOP], s.tolerance, |setup| setup.stop = None);
    "later-stop-time": "independent-of-stop-time",
        |s| same_with(s, ["with a later stop time", STOP], s.tolerance, |setup| {
            setup.stop = setup.stop.map(|stop| stop + 9.0 * (stop - s.start));
        });
    "summed-times": "rounded-times",
        |s| same_with(s, ["with times that are rounded in another way", ""], s.tolerance.max(runs::RESTART),
            |setup| setup.summed_times = true);
    "step-size": "variable-step-size", runs::step_sizes, Quick, CoSimulation, VARIABLE_STEPS;
    "micro-steps": "micro-steps",
        |s| same_with(s, ["with each step in two parts, the second of 1e-9 of its size", WHOLE],
            s.tolerance.max(COARSE), |setup| setup.fractions = &[1.0 - 1e-9, 1e-9]),
        CoSimulation, VARIABLE_STEPS;
    "half-steps": "half-steps",
        |s| same_with(s, ["with each step in two halves", WHOLE],
            s.tolerance.max(COARSE), |setup| setup.fractions = &[0.5, 0.5]),
        CoSimulation, VARIABLE_STEPS;
    "long-steps": "long-steps", steps::long_steps, CoSimulation, VARIABLE_STEPS;
    "stop-time-passed": "past-stop-time", host::past_stop, Misuse, Fmi2, CoSimulation;
    "end": "get-after-terminate", runs::end;
    "get": "get-is-pure", values::get;
    "nothing": "zero-references", values::nothing, Own;
    "aliases": "aliases", values::aliases;
    "kept": "inputs-kept", values::kept;
    "kept-arrays": "inputs-kept", values::kept_arrays, Quick, Fmi3;
    "tunable": "tunable", values::tunable, CoSimulation;
    "dependencies": "true-dependencies", values::dependencies;
    "initial-dependencies": "true-dependencies", values::initial_dependencies;
    "states": "state-variables", values::states, ModelExchange;
    "events": "event-iteration", values::events, ModelExchange;
    "array-lengths": "array-lengths", host::array_lengths, Misuse, Fmi3;
    "sizes": "structural-parameters", values::sizes, Quick, Fmi3, CoSimulation;
    "input-events": "input-events", interfaces::input_events, CoSimulation, Several;
    "adjoint": "adjoint-derivatives", values::adjoint_derivatives, Quick, Fmi3, ADJOINT;
    "event-mode": "event-mode", runs::event_mode, Quick, Fmi3, CoSimulation, Claims("hasEventMode");
    "flags": "runs", runs::flags, Quick, Fmi3, CoSimulation;
    "start-time": "start-time", runs::start_time, Quick;
    "tunable-effect": "tunable-effect", runs::tunable_effect, CoSimulation;
    "null": "free-null", host::null, Own, Fmi2;
    "no-logger": "no-logger", host::no_logger, Own;
    "no-resources": "no-resource-location", host::no_resources, Own;
    "resource-path": "resource-path", host::resource_path;
    "memory-functions": "memory-functions", host::memory_functions, Fmi2, Claims("canNotUseMemoryManagementFunctions");
    "strings": "arguments-copied", host::short_lived_strings, Own;
    "format": "log-format", |s| host::with_text(s, "percent signs", "%s%s%n%s%s%n%s%s%n%d"), Own;
    "logging": "logging-off", host::logging;
    "host": "handles", host::process;
    "memory": "memory", host::memory;
    "debug-logging": "runs", host::debug_logging, Misuse;
    "long": "long-texts", |s| host::with_text(s, "20000 characters", &"long".repeat(5000)), Own;
    "initial-outputs": "initial-outputs", values::initial_outputs, CoSimulation;
    "nan": "survives-nan", host::nan, Own, Brief;
    "infinity": "survives-nan", |s| host::with_inputs(s, &[f64::INFINITY, f64::NEG_INFINITY, 1e300]), Own, Brief;
    "damaged-state": "damaged-state", host::damaged_state, Misuse, STATE, BYTES;
    "settable": "settable", host::settable, Misuse;
    "step-nan": "step-arguments", host::step_nan, Misuse, CoSimulation;
    "status": "survives-misuse", host::status, Misuse, Fmi2, CoSimulation;
    "after-error": "after-error", host::after_error, Misuse;
};

#[test]
fn tests_have_different_names() {
    let names = [FIRST, INSTANCES, MISTAKES, OTHERS].into_iter().flatten().map(|probe| probe.name);
    let different: std::collections::HashSet<_> = names.clone().collect();
    assert_eq!(names.count(), different.len());
}
