//! The tests of a binary. Each runs in a process of its own.

mod derivatives;
mod host;
mod misuse;
mod runs;
mod values;

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use fmu_description::xml::{self, Element};
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_host::Library;
use fmu_worker::Service;

use super::rules;
use super::run::{OrSkip, Skip, Subject, claims};
use super::task::{FMU, Reply, Report, Task};
use super::values::Trajectory;
use crate::rule::Rule;

/// A test.
pub struct Probe {
    pub name: &'static str,
    /// The rule that it breaks if it fails.
    pub rule: &'static Rule,
    test: Test,
    /// What else is to know about it.
    traits: &'static [Trait],
}

enum Test {
    /// A function, whose error is a finding.
    Of(fn(&Subject<'_>) -> Result<()>),
    /// A run that differs from the usual run in what must not matter.
    Same {
        /// What is different, such as `after fmi2Reset`, and what the usual run has done.
        how: &'static str,
        like: &'static str,
        /// The relative difference of results that are equal.
        tolerance: fn(&Subject<'_>) -> f64,
        /// The run; the function receives `how`.
        run: fn(&Subject<'_>, &str) -> Result<Trajectory>,
    },
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
    /// The allocator checks the heap, and ends the process if it is damaged.
    HeapChecked,
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
use Test::Of;
use Trait::{
    Brief, Claims, CoSimulation, Fmi2, Fmi3, HeapChecked, Misuse, ModelExchange, Own, Quick,
    Several, Unloads,
};

impl Probe {
    pub fn is_quick(&self) -> bool {
        self.traits.contains(&Quick)
    }

    /// The rule that it breaks if the process crashes, hangs or ends.
    pub fn crash(&self) -> &'static Rule {
        match self.traits {
            traits if traits.contains(&Misuse) => &rules::SURVIVES_MISUSE,
            traits if traits.contains(&Own) => self.rule,
            traits if traits.contains(&HeapChecked) => &rules::HEAP,
            _ => &rules::SURVIVES,
        }
    }

    /// Its time limit in seconds, given the usual one.
    pub fn seconds(&self, usual: u64) -> u64 {
        const FEW: u64 = 5;
        match self.traits.contains(&Misuse) || self.traits.contains(&Brief) {
            true => usual.min(FEW),
            false => usual,
        }
    }

    /// Whether it is for an interface type of an FMU, given by its element.
    pub fn applies(&self, element: &Element<'_>, version: FmiVersion) -> bool {
        self.traits.iter().all(|needed| match needed {
            CoSimulation => element.name == "CoSimulation",
            ModelExchange => element.name == "ModelExchange",
            Fmi2 => version == FmiVersion::Fmi2,
            Fmi3 => version == FmiVersion::Fmi3,
            Several => !claims(element, "canBeInstantiatedOnlyOncePerProcess", version),
            Claims(flag) => claims(element, flag, version),
            _ => true,
        })
    }

    /// What the FMU declares, if the test is about that.
    fn claim(&self) -> Option<String> {
        self.traits.iter().rev().find_map(|about| match about {
            Claims(flag) => Some(format!("{flag} is true, but")),
            Several => Some("canBeInstantiatedOnlyOncePerProcess is false, but".into()),
            _ => None,
        })
    }

    /// Runs it, in the child process.
    pub fn run(&self, subject: &Subject<'_>) -> Result<()> {
        let outcome = match &self.test {
            Test::Of(test) => test(subject),
            Test::Same {
                how,
                like,
                tolerance,
                run,
            } => subject.usual().and_then(|usual| {
                let actual = run(subject, how)?;
                subject
                    .observed
                    .ensure_same(&actual, usual, tolerance(subject), how, like)
            }),
        };
        match (outcome, self.claim()) {
            (Err(error), _) if error.is::<Skip>() => Ok(()),
            (Err(error), Some(claim)) => Err(error.context(claim)),
            (outcome, _) => outcome,
        }
    }
}

/// Receives a test of a binary in this process, which [`crate::Probes`] has started, and runs it.
///
/// # Errors
/// The process was not started for a test, or the unpacked FMU cannot be read.
pub fn run() -> Result<()> {
    let service = Service::of_this_process()?;
    let mut service = service.context("it is started by `validate` only")?;
    let task: Task = service.task()?.context("there is no test to run")?;
    let text = std::fs::read_to_string(task.session.join(MODEL_DESCRIPTION))?;
    let root = xml::parse(&text)?;
    let model = ModelDescription::read(&root)?;
    let report = Arc::new(Report::new(service, model.version));
    let mut all = FIRST.iter().chain(PROBES);
    let probe = all.find(|probe| probe.name == task.probe);
    let probe = probe.context("there is no such test")?;
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
        report.fail(probe.rule, &text);
    }
    if probe.traits.contains(&Unloads) {
        settle();
        drop(library);
    }
    report.reply(&Reply::Done);
    Ok(())
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
    ($($name:literal: $rule:ident, $test:expr $(, $trait:expr)*;)*) => {
        &[$(Probe {
            name: $name,
            rule: &rules::$rule,
            test: $test,
            traits: &[$($trait),*],
        }),*]
    };
}

/// A run that must be the same as the usual run.
const fn same(
    how: &'static str,
    like: &'static str,
    tolerance: fn(&Subject<'_>) -> f64,
    run: fn(&Subject<'_>, &str) -> Result<Trajectory>,
) -> Test {
    Test::Same {
        how,
        like,
        tolerance,
        run,
    }
}

/// The rounding of vectorized loops.
const ROUNDING: fn(&Subject<'_>) -> f64 = |_| 1e-9;
/// The tolerance of the FMU's solver.
const SOLVER: fn(&Subject<'_>) -> f64 = |subject| subject.tolerance();
/// The error of other step sizes.
const COARSE: fn(&Subject<'_>) -> f64 = |subject| subject.tolerance().max(1e-3);

/// The tests on whose results the others depend.
static FIRST: &[Probe] = probes! {
    "identity": LOADS, Of(host::identity), Unloads;
    "readable": RUNS, Of(values::readable);
    "experiment": RUNS, Of(runs::experiment);
    "trace": RUNS, Of(|subject| runs::trace(subject, subject.setup()));
    "trace-logging": INDEPENDENT, Of(|subject| {
        runs::trace(subject, subject.setup().with(|s| (s.name, s.logging) = ("another_name", true)))
    });
    // What is no crash, another test finds.
    "heap": RUNS, Of(|subject| host::lives(subject).or_skip()), HeapChecked;
};
/// The binary loads and creates an instance.
pub static IDENTITY: &Probe = &FIRST[0];
/// The variables that cannot be read.
pub static READABLE: &Probe = &FIRST[1];
/// A run to the end of the default experiment.
pub static EXPERIMENT: &Probe = &FIRST[2];
/// A short run, which is compared between processes.
pub static TRACE: &Probe = &FIRST[3];
/// As [`TRACE`], with another name of the instance and with logging.
pub static TRACE_LOGGING: &Probe = &FIRST[4];
/// The life of an instance under an allocator that checks the heap.
pub static HEAP_CHECK: &Probe = &FIRST[5];

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

/// All other tests.
pub static PROBES: &[Probe] = probes! {
    // First, since other tests make no mistakes if these crash.
    "mistakes": SURVIVES_MISUSE, Of(misuse::mistakes), Misuse;
    "unknown-get": UNKNOWN_REFERENCE, Of(misuse::unknown_get), Misuse;
    "unknown-set": UNKNOWN_REFERENCE, Of(misuse::unknown_set), Misuse;
    "step-arguments": STEP_ARGUMENTS, Of(misuse::step_arguments), Misuse, CoSimulation;
    "order": ORDER, Of(misuse::order), Misuse;
    // The others.
    "guid": GUID, Of(host::guid), Quick;
    "start": START, Of(values::start), Quick;
    "state": STATE, Of(runs::restore), Quick, STATE;
    "serialized": SERIALIZED, Of(runs::serialize), Quick, STATE, BYTES;
    "directional": DIRECTIONAL, Of(derivatives::of_outputs), Quick, DIRECTIONAL;
    "directional-states": DIRECTIONAL, Of(derivatives::of_states), Quick, ModelExchange, DIRECTIONAL;
    "input-derivatives": INPUT_DERIVATIVES, Of(derivatives::of_inputs_in_time),
        Quick, Fmi2, CoSimulation, INTERPOLATES;
    "output-derivatives": OUTPUT_DERIVATIVES, Of(derivatives::of_outputs_in_time), Quick, CoSimulation;
    "instances": SEPARATE, same("with a second instance", ALONE, ROUNDING, runs::beside), Quick, Several;
    "reset": RESET, same("after fmi2Reset", NEW, SOLVER, runs::reset), Quick;
    "reset-new": RESET, same("after fmi2Reset of a new instance", NEW, SOLVER, runs::reset_new);
    "reset-initializing": RESET,
        same("after fmi2Reset in initialization mode", NEW, SOLVER, runs::reset_initializing);
    "reset-values": RESET, Of(runs::reset_values);
    "previous": SEPARATE,
        same("after another instance was freed", ALONE, ROUNDING, runs::after_another);
    "thread": THREADS, same("on another thread", ALONE, ROUNDING, runs::on_a_thread);
    "threads": THREADS, Of(runs::on_threads), Own, Several;
    "strings-of-instances": STRINGS, Of(values::strings_of_instances), Several;
    "no-stop-time": STOP_TIME,
        same("without a stop time", STOP, SOLVER, |s, how| runs::with(s, how, |setup| setup.stop = None));
    "later-stop-time": STOP_TIME,
        same("with a later stop time", STOP, SOLVER, |s, how| runs::with(s, how, |setup| {
            setup.stop = setup.stop.map(|stop| stop + 9.0 * (stop - s.start()));
        }));
    "summed-times": ROUNDED_TIMES,
        same("with times that are rounded in another way", "", SOLVER,
            |s, how| runs::with(s, how, |setup| setup.summed_times = true));
    "step-size": STEP_SIZE, Of(runs::step_sizes), Quick, CoSimulation, VARIABLE_STEPS;
    "micro-steps": MICRO_STEPS,
        same("with each step in two parts, the second of 1e-9 of its size", WHOLE, COARSE,
            |s, how| runs::with(s, how, |setup| setup.fractions = &[1.0 - 1e-9, 1e-9])),
        CoSimulation, VARIABLE_STEPS;
    "half-steps": HALF_STEPS,
        same("with each step in two halves", WHOLE, COARSE,
            |s, how| runs::with(s, how, |setup| setup.fractions = &[0.5, 0.5])),
        CoSimulation, VARIABLE_STEPS;
    "stop-time-passed": PAST_STOP, Of(misuse::past_stop), Misuse, Fmi2, CoSimulation;
    "end": GET_AFTER_END, Of(runs::end);
    "get": PURE_GET, Of(values::get);
    "nothing": NO_VARIABLES, Of(values::nothing), Own;
    "aliases": ALIASES, Of(values::aliases);
    "kept": INPUTS_KEPT, Of(values::kept);
    "kept-arrays": INPUTS_KEPT, Of(values::kept_arrays), Quick, Fmi3;
    "tunable": TUNABLE, Of(values::tunable), CoSimulation;
    "dependencies": DEPENDENCIES, Of(derivatives::dependencies);
    "events": EVENTS, Of(derivatives::events), ModelExchange;
    "array-lengths": ARRAY_LENGTHS, Of(misuse::array_lengths), Misuse, Fmi3;
    "sizes": SIZES, Of(values::sizes), Quick, Fmi3, CoSimulation;
    "adjoint": ADJOINT, Of(derivatives::adjoint), Quick, Fmi3, ADJOINT;
    "event-mode": EVENT_MODE, Of(runs::event_mode), Quick, Fmi3, CoSimulation, Claims("hasEventMode");
    "null": FREE_NULL, Of(host::null), Own, Fmi2;
    "no-logger": NO_LOGGER, Of(host::no_logger), Own;
    "no-resources": NO_RESOURCES, Of(host::no_resources), Own;
    "strings": ARGUMENTS_COPIED, Of(host::short_lived_strings), Own;
    "format": LOG_FORMAT, Of(|s| host::with_text(s, "percent signs", "%s%s%n%s%s%n%s%s%n%d")), Own;
    "logging": LOGGING_OFF, Of(host::logging);
    "host": HANDLES, Of(host::process);
    "memory": MEMORY, Of(host::memory);
    "debug-logging": RUNS, Of(host::debug_logging), Misuse;
    "long": LONG_TEXTS, Of(|s| host::with_text(s, "20000 characters", &"long".repeat(5000))), Own;
    "initial-outputs": INITIAL_OUTPUTS, Of(values::initial_outputs), CoSimulation;
    "nan": NAN, Of(|s| misuse::with_inputs(s, &[f64::NAN])), Own, Brief;
    "infinity": NAN, Of(|s| misuse::with_inputs(s, &[f64::INFINITY, f64::NEG_INFINITY, 1e300])),
        Own, Brief;
    "damaged-state": DAMAGED_STATE, Of(runs::damaged), Misuse, STATE, BYTES;
    "settable": SETTABLE, Of(misuse::settable), Misuse;
    "step-nan": STEP_ARGUMENTS, Of(misuse::step_nan), Misuse, CoSimulation;
    "status": SURVIVES_MISUSE, Of(misuse::status), Misuse, Fmi2, CoSimulation;
    "after-error": AFTER_ERROR, Of(misuse::after_error), Misuse;
};

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn tests_have_different_names() {
        let names: HashSet<_> = FIRST.iter().chain(PROBES).map(|probe| probe.name).collect();
        assert_eq!(names.len(), FIRST.len() + PROBES.len());
    }
}
