//! The tests of a binary. Each runs in a process of its own.

mod clocks;
mod dependencies;
mod derivatives;
mod equations;
mod host;
mod interfaces;
mod misuse;
mod regions;
mod runs;
mod steps;
mod time_derivatives;
mod variables;

use anyhow::{Context, Result};
use fmu_description::FmiVersion;
use fmu_description::xml::Element;

use crate::binary::observed::Trajectory;
use crate::binary::run::Run;
use crate::binary::subject::{RunSetup, SKIP, Subject};
use crate::binary::vocabulary::{ONLY_ONCE, claims};
use crate::rule::{Rule, rule};
use Trait::{
    Brief, Claims, CoSimulation, Events, Fmi2, Fmi3, Misuse, ModelExchange, Own, Quick, Scheduled,
    Several, Unloads,
};

/// A test.
pub struct Probe {
    pub name: &'static str,
    /// The rule that it breaks if it fails.
    pub rule: &'static Rule,
    /// The error is a finding.
    test: fn(&Subject<'_>) -> Result<()>,
    /// The properties of the test.
    traits: &'static [Trait],
}

/// A property of a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trait {
    /// The test belongs to the quick tests.
    Quick,
    /// Its calls are those that hosts must not make; if they crash, that is no error of the FMU.
    Misuse,
    /// If the process crashes, hangs or ends, that breaks the same rule.
    Own,
    /// The test takes a few seconds at most.
    Brief,
    /// The library is unloaded before the test ends.
    Unloads,
    /// The test is for co-simulation, for model exchange, or for scheduled execution.
    CoSimulation,
    ModelExchange,
    Scheduled,
    /// The test is for interface types with an event mode. It may read what it has set without a step between.
    Events,
    /// The test is for one version of FMI.
    Fmi2,
    Fmi3,
    /// A process may have several instances.
    Several,
    /// The FMU declares this flag, named as in FMI 2.0.
    Claims(&'static str),
}

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

    /// Whether it looks for state that instances share.
    pub fn compares_instances(&self) -> bool {
        *self.rule == *rule!("separate-instances")
    }

    /// Whether the library is unloaded before the test ends.
    pub fn unloads(&self) -> bool {
        self.traits.contains(&Unloads)
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
            Scheduled => element.name == "ScheduledExecution",
            Events => element.name != "ScheduledExecution",
            Fmi2 => version == FmiVersion::Fmi2,
            Fmi3 => version == FmiVersion::Fmi3,
            Several => !is_alone,
            Claims(flag) => claims(element, flag, version),
            _ => true,
        })
    }

    /// The declaration of the FMU that is tested, if any.
    fn claim(&self) -> Option<String> {
        self.traits.iter().rev().find_map(|about| match about {
            Claims(flag) => Some(format!("{flag} is true, but")),
            Several if !self.compares_instances() => Some(format!("{ONLY_ONCE} is false, but")),
            _ => None,
        })
    }

    /// Runs it, in the worker process.
    pub fn run(&self, subject: &Subject<'_>) -> Result<()> {
        match ((self.test)(subject), self.claim()) {
            (Err(error), _) if error.downcast_ref() == Some(&SKIP) => Ok(()),
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
    change: impl FnOnce(&mut RunSetup<'_>),
) -> Result<()> {
    same(subject, how, tolerance, |subject, how| {
        subject.report.stage(how);
        Run::recorded(subject, subject.setup().with(change))
    })
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

/// The tests on whose results all other tests depend.
static FIRST: &[Probe] = probes! {
    // The binary loads and creates an instance.
    "identity": "loads", host::identity, Unloads;
    // Which variables cannot be read.
    "readable": "runs", variables::readable;
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
    "mistakes": "survives-misuse", misuse::mistakes, Misuse;
    "unknown": "unknown-references", misuse::unknown_references, Misuse;
    "step-arguments": "step-arguments", misuse::step_arguments, Misuse, CoSimulation;
    "order": "order-of-calls", misuse::order, Misuse;
    "order-of-setup": "order-of-calls", misuse::order_of_setup, Misuse, Fmi2;
    "order-of-steps": "order-of-calls", misuse::order_of_steps, Misuse, CoSimulation;
};

/// All other tests.
pub static OTHERS: &[Probe] = probes! {
    "guid": "guid-checked", misuse::guid, Quick;
    "start": "start-values", variables::start, Quick;
    "state": "state", runs::restore, Quick, STATE;
    "serialized": "serialized-state", runs::serialize, Quick, STATE, BYTES;
    "directional": "directional-derivatives", derivatives::in_run, Quick, DIRECTIONAL, Events;
    "directional-elsewhere": "directional-derivatives", derivatives::elsewhere, DIRECTIONAL, Events;
    "dependencies-kind": "dependencies-kind", dependencies::kinds, Events;
    "directional-initial": "directional-derivatives", derivatives::in_initialization, DIRECTIONAL, Events;
    "directional-unlisted": "directional-derivatives", derivatives::unlisted, Misuse, DIRECTIONAL, Events;
    "input-derivatives": "input-derivatives", time_derivatives::of_inputs,
        Quick, Fmi2, CoSimulation, INTERPOLATES;
    "output-derivatives": "output-derivatives", time_derivatives::of_outputs, Quick, CoSimulation;
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
    "strings-of-instances": "string-lifetime", variables::strings_of_instances, Several;
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
    "stop-time-passed": "past-stop-time", misuse::past_stop, Misuse, Fmi2, CoSimulation;
    "end": "get-after-terminate", runs::end;
    "get": "get-is-pure", variables::get, Events;
    "nothing": "zero-references", variables::nothing, Own;
    "aliases": "aliases", variables::aliases;
    "kept": "inputs-kept", variables::kept, Events;
    "kept-arrays": "inputs-kept", variables::kept_arrays, Quick, Fmi3, Events;
    "tunable": "tunable", variables::tunable, CoSimulation;
    "dependencies": "true-dependencies", dependencies::direct, Events;
    "initial-dependencies": "true-dependencies", dependencies::initial, Events;
    "states": "state-variables", equations::states, ModelExchange;
    "events": "event-iteration", equations::events, ModelExchange;
    "array-lengths": "array-lengths", misuse::array_lengths, Misuse, Fmi3, Events;
    "sizes": "structural-parameters", variables::sizes, Quick, Fmi3, CoSimulation;
    "input-events": "input-events", interfaces::input_events, CoSimulation, Several;
    "adjoint": "adjoint-derivatives", derivatives::adjoint, Quick, Fmi3, ADJOINT, Events;
    "fractions": "interval-fraction", clocks::fractions, Quick, Fmi3, Several;
    "clocked-kept": "clocked-kept", clocks::kept, Misuse, Fmi3;
    "evaluated": "evaluate-once", clocks::evaluated, Quick, Fmi3, Events, Claims("providesEvaluateDiscreteStates");
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
    "initial-outputs": "initial-outputs", variables::initial_outputs, CoSimulation;
    "nan": "survives-nan", misuse::nan, Own, Brief, Events;
    "infinity": "survives-nan", |s| misuse::with_inputs(s, &[f64::INFINITY, f64::NEG_INFINITY, 1e300]), Own, Brief, Events;
    "damaged-state": "damaged-state", misuse::damaged_state, Misuse, STATE, BYTES;
    "settable": "settable", misuse::settable, Misuse, Events;
    "clocked-settable": "clocked-settable", clocks::settable, Misuse, Fmi3, CoSimulation;
    "clock-references": "unknown-references", clocks::references, Misuse, Fmi3, CoSimulation;
    "partitions": "partition-order", clocks::partitions, Misuse, Scheduled;
    "step-nan": "step-arguments", misuse::step_nan, Misuse, CoSimulation;
    "status": "survives-misuse", misuse::status, Misuse, Fmi2, CoSimulation;
    "after-error": "after-error", misuse::after_error, Misuse;
};

#[test]
fn tests_have_different_names() {
    let names = [FIRST, INSTANCES, MISTAKES, OTHERS].into_iter().flatten().map(|probe| probe.name);
    let different: std::collections::HashSet<_> = names.clone().collect();
    assert_eq!(names.count(), different.len());
}
