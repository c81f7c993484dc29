//! The tests of a binary. Each runs in a process of its own.

mod arrays;
mod calls;
mod derivatives;
mod host;
mod instances;
mod loading;
mod simulation;
mod state;
mod values;

use anyhow::Result;
use fmu_description::FmiVersion;

use super::rules;
use super::subject::Subject;
use crate::Rule;

/// A test.
pub struct Test {
    /// Name on the command line.
    pub name: &'static str,
    /// The rule that it breaks if it fails.
    pub rule: &'static Rule,
    /// The rule that it breaks if the process crashes, hangs or ends.
    pub crash: &'static Rule,
    /// Whether it is one of the quick tests.
    pub is_quick: bool,
    /// The only version of FMI that it is for, if it is not for both.
    pub only_of: Option<FmiVersion>,
    /// Maximum time limit in seconds.
    pub seconds: u64,
    /// Runs it.
    pub run: fn(&Subject<'_>) -> Result<()>,
}

impl std::fmt::Debug for Test {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

const fn test(
    name: &'static str,
    rule: &'static Rule,
    run: fn(&Subject<'_>) -> Result<()>,
) -> Test {
    Test {
        name,
        rule,
        crash: &rules::SURVIVES,
        is_quick: false,
        only_of: None,
        seconds: u64::MAX,
        run,
    }
}

impl Test {
    const fn quick(mut self) -> Self {
        self.is_quick = true;
        self
    }

    /// A test with calls that hosts must not make.
    const fn misuse(mut self) -> Self {
        self.crash = &rules::SURVIVES_MISUSE;
        self.within(5)
    }

    const fn crash(mut self, rule: &'static Rule) -> Self {
        self.crash = rule;
        self
    }

    /// A test of what FMI 3.0 has not, or leaves open.
    const fn of_fmi_2(mut self) -> Self {
        self.only_of = Some(FmiVersion::Fmi2);
        self
    }

    /// A test of what FMI 2.0 has not.
    const fn of_fmi_3(mut self) -> Self {
        self.only_of = Some(FmiVersion::Fmi3);
        self
    }

    const fn within(mut self, seconds: u64) -> Self {
        self.seconds = seconds;
        self
    }
}

/// The binary loads and creates an instance.
pub static IDENTITY: Test = test("identity", &rules::LOADS, loading::identity);
/// The variables that cannot be read, one per value of the report.
pub static READABLE: Test = test("readable", &rules::RUNS, values::readable);
/// A run to the end of the default experiment; it reports the number of steps and the time taken.
pub static EXPERIMENT: Test = test("experiment", &rules::RUNS, simulation::experiment);
/// A short run whose digests are compared between processes.
pub static TRACE: Test = test("trace", &rules::RUNS, simulation::trace);
/// As [`TRACE`], with another name of the instance and with logging.
pub static TRACE_LOGGING: Test = test(
    "trace-logging",
    &rules::INDEPENDENT,
    simulation::trace_logging,
);

/// The life of an instance under an allocator that checks the heap.
pub static HEAP_CHECK: Test = test("heap", &rules::RUNS, host::lives).crash(&rules::HEAP);

/// The tests above, on whose results the others depend.
static FIRST: [&Test; 6] = [
    &IDENTITY,
    &READABLE,
    &EXPERIMENT,
    &TRACE,
    &TRACE_LOGGING,
    &HEAP_CHECK,
];

/// The test of a name.
pub fn find(name: &str) -> Option<&'static Test> {
    let mut all = FIRST.into_iter().chain(TESTS);
    all.find(|test| test.name == name)
}

/// All other tests.
pub static TESTS: &[Test] = &[
    // First, since other tests make no mistakes if these crash.
    test("mistakes", &rules::SURVIVES_MISUSE, calls::mistakes).misuse(),
    test("unknown-get", &rules::UNKNOWN_REFERENCE, calls::unknown_get).misuse(),
    test("unknown-set", &rules::UNKNOWN_REFERENCE, calls::unknown_set).misuse(),
    test(
        "step-arguments",
        &rules::STEP_ARGUMENTS,
        calls::step_arguments,
    )
    .misuse(),
    test("order", &rules::ORDER, calls::order).misuse(),
    // The others.
    test("guid", &rules::GUID, loading::guid).quick(),
    test("start", &rules::START, values::start).quick(),
    test("state", &rules::STATE, state::restore).quick(),
    test("serialized", &rules::SERIALIZED, state::serialize).quick(),
    test("directional", &rules::DIRECTIONAL, derivatives::directional).quick(),
    test(
        "directional-states",
        &rules::DIRECTIONAL,
        derivatives::of_states,
    )
    .quick(),
    test(
        "input-derivatives",
        &rules::INPUT_DERIVATIVES,
        derivatives::of_inputs,
    )
    .quick()
    .of_fmi_2(),
    test(
        "output-derivatives",
        &rules::OUTPUT_DERIVATIVES,
        derivatives::of_outputs,
    )
    .quick(),
    test("instances", &rules::SEPARATE, instances::beside).quick(),
    test("reset", &rules::RESET, simulation::reset).quick(),
    test("reset-early", &rules::RESET, simulation::reset_early),
    test("reset-values", &rules::RESET, simulation::reset_values),
    test("previous", &rules::SEPARATE, instances::after),
    test("thread", &rules::THREADS, instances::on_another_thread),
    test("threads", &rules::THREADS, instances::at_the_same_time).crash(&rules::THREADS),
    test("strings-of-instances", &rules::STRINGS, instances::strings),
    test("stop-time", &rules::STOP_TIME, simulation::stop_time),
    test("step-size", &rules::STEP_SIZE, simulation::step_size).quick(),
    test("micro-steps", &rules::MICRO_STEPS, simulation::micro_steps),
    test(
        "summed-times",
        &rules::ROUNDED_TIMES,
        simulation::summed_times,
    ),
    test("stop-time-passed", &rules::PAST_STOP, calls::past_stop)
        .misuse()
        .of_fmi_2(),
    test("half-steps", &rules::HALF_STEPS, simulation::half_steps),
    test("end", &rules::GET_AFTER_END, simulation::end),
    test("get", &rules::PURE_GET, values::get),
    test("nothing", &rules::NO_VARIABLES, values::nothing).crash(&rules::NO_VARIABLES),
    test("aliases", &rules::ALIASES, values::aliases),
    test("kept", &rules::INPUTS_KEPT, values::kept),
    test("tunable", &rules::TUNABLE, values::tunable),
    test(
        "dependencies",
        &rules::DEPENDENCIES,
        derivatives::dependencies,
    ),
    test("events", &rules::EVENTS, derivatives::events),
    test("arrays", &rules::RUNS, arrays::values)
        .quick()
        .of_fmi_3(),
    test("array-starts", &rules::START, arrays::starts)
        .quick()
        .of_fmi_3(),
    test("array-lengths", &rules::ARRAY_LENGTHS, arrays::lengths)
        .misuse()
        .of_fmi_3(),
    test("sizes", &rules::SIZES, arrays::sizes)
        .quick()
        .of_fmi_3(),
    test("adjoint", &rules::ADJOINT, derivatives::adjoint)
        .quick()
        .of_fmi_3(),
    test("event-mode", &rules::EVENT_MODE, simulation::event_mode)
        .quick()
        .of_fmi_3(),
    test("null", &rules::FREE_NULL, loading::null)
        .crash(&rules::FREE_NULL)
        .of_fmi_2(),
    test("no-logger", &rules::NO_LOGGER, loading::no_logger).crash(&rules::NO_LOGGER),
    test("no-resources", &rules::NO_RESOURCES, loading::no_resources).crash(&rules::NO_RESOURCES),
    test(
        "strings",
        &rules::ARGUMENTS_COPIED,
        loading::short_lived_strings,
    )
    .crash(&rules::ARGUMENTS_COPIED),
    test("format", &rules::LOG_FORMAT, loading::percent_signs).crash(&rules::LOG_FORMAT),
    test("logging", &rules::LOGGING_OFF, host::logging),
    test("host", &rules::HANDLES, host::process),
    test("memory", &rules::MEMORY, host::memory),
    test("debug-logging", &rules::RUNS, host::debug_logging).misuse(),
    test("long", &rules::LONG_TEXTS, loading::long_texts).crash(&rules::LONG_TEXTS),
    test(
        "initial-outputs",
        &rules::INITIAL_OUTPUTS,
        values::initial_outputs,
    ),
    test("nan", &rules::NAN, calls::nan)
        .crash(&rules::NAN)
        .within(5),
    test("infinity", &rules::NAN, calls::infinity)
        .crash(&rules::NAN)
        .within(5),
    test("damaged-state", &rules::DAMAGED_STATE, state::damaged).misuse(),
    test("settable", &rules::SETTABLE, calls::settable).misuse(),
    test("step-nan", &rules::STEP_ARGUMENTS, calls::step_nan).misuse(),
    test("status", &rules::SURVIVES_MISUSE, calls::status)
        .misuse()
        .of_fmi_2(),
    test("after-error", &rules::AFTER_ERROR, calls::after_error).misuse(),
];

#[cfg(test)]
mod check {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn tests_have_different_names() {
        let all = FIRST.into_iter().chain(TESTS);
        let names: HashSet<_> = all.map(|test| test.name).collect();
        assert_eq!(names.len(), FIRST.len() + TESTS.len());
    }
}
