//! Calls that hosts must not make, or make only by mistake.

use std::collections::HashSet;

use anyhow::Result;
use fmu_description::{Causality, FmiVersion, Listed, Type, Value, Variability};
use fmu_file::text::quote;
use fmu_host::{Instance, Kind, fmi2};

use crate::binary::rules;
use crate::binary::run::{Run, Setup, Subject, readable, report};
use crate::binary::values::{is_tested, other};
use crate::rule::Rule;

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

/// Where in its life an instance is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum At {
    New,
    Initializing,
    Begun,
    Stepped,
    Terminated,
}
use At::{Begun, Initializing, New, Stepped, Terminated};

impl At {
    fn run<'a>(self, subject: &'a Subject<'a>, setup: Setup<'a>) -> Result<Run<'a>> {
        let mut run = match self {
            New => Run::instantiate(subject, setup)?,
            Initializing => Run::initializing(subject, setup)?,
            Begun | Stepped | Terminated => Run::begin(subject, setup)?,
        };
        if self >= Stepped {
            run.advance()?;
        }
        if self == Terminated && !run.ended {
            run.instance.terminate()?;
        }
        Ok(run)
    }
}

struct Refused<'a> {
    subject: &'a Subject<'a>,
    accepted: Vec<String>,
}

impl<'a> Refused<'a> {
    fn new(subject: &'a Subject<'a>) -> Self {
        Self {
            subject,
            accepted: Vec::new(),
        }
    }

    /// Makes a call; `what` tells function and circumstances, such as `fmi2DoStep before initialization`.
    fn call(
        &mut self,
        what: impl Into<String>,
        at: At,
        call: impl FnOnce(&mut Run<'a>) -> fmu_host::Result,
    ) -> Result<()> {
        let what = what.into();
        let circumstances = what.split_once(' ').map_or("", |(_, when)| when);
        self.subject.report.stage(circumstances);
        let mut run = at.run(self.subject, self.subject.setup())?;
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

type Access = fn(&mut Instance, u32) -> fmu_host::Result;

const GET: [(&str, Type, Access); 3] = [
    ("fmi2GetReal", Type::Float64, |i, r| {
        i.get_float64(&[r], &mut [0.0])
    }),
    ("fmi2GetInteger", Type::Int32, |i, r| {
        i.get_int32(&[r], &mut [0])
    }),
    ("fmi2GetBoolean", Type::Boolean, |i, r| {
        i.get_boolean(&[r], &mut [0])
    }),
];

const SET: [(&str, Type, Access); 3] = [
    ("fmi2SetReal", Type::Float64, |i, r| {
        i.set_float64(&[r], &[0.0])
    }),
    ("fmi2SetInteger", Type::Int32, |i, r| {
        i.set_int32(&[r], &[0])
    }),
    ("fmi2SetBoolean", Type::Boolean, |i, r| {
        i.set_boolean(&[r], &[0])
    }),
];

/// Reads value references that do not exist, or have another type.
pub fn unknown_get(subject: &Subject<'_>) -> Result<()> {
    let mut refused = with_unknown(subject, &GET)?;
    let accessed = |v: &Listed<'_>| v.of_type.accessed_as(subject.model.version);
    let variables = || subject.model.variables().map(|(_, v)| v);
    let known: HashSet<_> = variables().map(|v| (accessed(v), v.reference)).collect();
    for (function, of_type, get) in GET {
        let mut seen = HashSet::new();
        let others = variables().filter(|v| {
            let is_other = accessed(v) != of_type && v.of_type != Type::Enumeration;
            is_other && is_tested(v) && !known.contains(&(of_type, v.reference))
        });
        // The first of each type.
        for variable in others.filter(|v| seen.insert(v.of_type)) {
            let (name, reference) = (quote(&variable.name), variable.reference);
            let what = format!("{function} for {name}, which has another type");
            refused.call(what, Begun, |run| get(&mut run.instance, reference))?;
        }
    }
    refused.report(&rules::UNKNOWN_REFERENCE)
}

/// Writes value references that do not exist.
pub fn unknown_set(subject: &Subject<'_>) -> Result<()> {
    with_unknown(subject, &SET)?.report(&rules::UNKNOWN_REFERENCE)
}

fn with_unknown<'a>(
    subject: &'a Subject<'a>,
    calls: &[(&str, Type, Access)],
) -> Result<Refused<'a>> {
    let reference = unknown(subject);
    let mut refused = Refused::new(subject);
    for (function, _, call) in calls {
        let what = format!("{function} for the unknown value reference {reference}");
        refused.call(what, Begun, |run| call(&mut run.instance, reference))?;
    }
    Ok(refused)
}

/// Sets what the XML does not allow to set.
pub fn settable(subject: &Subject<'_>) -> Result<()> {
    use Causality::{CalculatedParameter, Local, Output, Parameter};
    use Variability::{Constant, Continuous, Discrete, Fixed};
    // In model exchange, some hosts, such as CasADi, set the states one by one.
    let model = subject.model;
    let variables = model
        .variables()
        .filter(|_| subject.kind == Kind::ModelExchange);
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
        let Some(variable) = reals.find(|v| v.variability == variability) else {
            continue;
        };
        let value = match causality {
            Parameter => other(variable),
            _ => Some(Value::Float64(0.0)),
        };
        if let Some(value) = value {
            let name = quote(&variable.name);
            let what = format!("fmi2SetReal after initialization for {name}, {is}");
            refused.call(what, Stepped, |run| run.set(variable, &[value]))?;
        }
    }
    refused.report(&rules::SETTABLE)
}

/// Takes steps with a wrong size or time.
pub fn step_arguments(subject: &Subject<'_>) -> Result<()> {
    let (start, step) = (subject.start(), subject.step());
    let wrong = [
        ("a negative step size", start + step, -step),
        ("a time before the current one", start, step),
        ("a time after the current one", start + 100.0 * step, step),
    ];
    steps(subject, wrong)
}

/// Takes steps with invalid numbers.
pub fn step_nan(subject: &Subject<'_>) -> Result<()> {
    let (start, step) = (subject.start(), subject.step());
    let wrong = [
        ("a step size of NaN", start + step, f64::NAN),
        ("an infinite step size", start + step, f64::INFINITY),
        ("a time of NaN", f64::NAN, step),
    ];
    steps(subject, wrong)
}

fn steps(subject: &Subject<'_>, wrong: [(&str, f64, f64); 3]) -> Result<()> {
    let mut refused = Refused::new(subject);
    for (what, time, step) in wrong {
        let what = format!("fmi2DoStep with {what}");
        refused.call(what, Stepped, |run| run.instance.do_step(time, step))?;
    }
    refused.report(&rules::STEP_ARGUMENTS)
}

/// Makes calls in a wrong order.
pub fn order(subject: &Subject<'_>) -> Result<()> {
    let (start, step) = (subject.start(), subject.step());
    let mut refused = Refused::new(subject);
    if subject.kind == Kind::CoSimulation {
        for (when, at, time) in [
            ("before initialization", New, start),
            ("in initialization mode", Initializing, start),
            ("after fmi2Terminate", Terminated, start + step),
        ] {
            let what = format!("fmi2DoStep {when}");
            refused.call(what, at, |run| run.instance.do_step(time, step))?;
        }
    }
    let what = "fmi2ExitInitializationMode before fmi2EnterInitializationMode";
    refused.call(what, New, |run| run.instance.exit_initialization_mode())?;
    let what = "fmi2EnterInitializationMode after initialization";
    refused.call(what, Stepped, |run| {
        run.instance.enter_initialization_mode()
    })?;
    if subject.model.version == FmiVersion::Fmi2 {
        let what = "fmi2SetupExperiment after initialization";
        let call = |run: &mut Run<'_>| run.instance.setup_experiment(start, None, None);
        refused.call(what, Stepped, call)?;
    }
    refused.report(&rules::ORDER)
}

/// Takes a step beyond the stop time.
pub fn past_stop(subject: &Subject<'_>) -> Result<()> {
    const WHAT: &str = "fmi2DoStep beyond the stop time";
    let step = subject.step();
    let stop = subject.start() + 2.0 * step;
    subject.report.stage(WHAT);
    let mut run = Stepped.run(subject, subject.setup().with(|s| s.stop = Some(stop)))?;
    run.advance()?;
    let mut refused = Refused::new(subject);
    if !run.ended && run.instance.do_step(run.time(), step).is_ok() {
        refused.accepted.push(WHAT.to_owned());
    }
    refused.report(&rules::PAST_STOP)
}

/// Passes other numbers of values than arrays have.
pub fn array_lengths(subject: &Subject<'_>) -> Result<()> {
    let mut accepted = Vec::new();
    // Also those that cannot be read.
    let none = HashSet::new();
    let arrays = readable(subject.model, &none).filter(|v| !v.dimensions.is_empty());
    for variable in arrays.take(4) {
        let (name, n) = (quote(&variable.name), variable.count());
        for wrong in [n + 1, n.saturating_sub(1)] {
            let mut run = Begun.run(subject, subject.setup())?;
            subject
                .report
                .stage(format!("for {wrong} values of {name}"));
            if run.read_elements(variable, wrong).is_ok() {
                accepted.push(format!("{wrong} values of {name}, which has {n}"));
            }
        }
    }
    if !accepted.is_empty() {
        let accepted = accepted.join("; ");
        report!(
            subject,
            ARRAY_LENGTHS,
            "these were read with fmi3OK, expected fmi3Error: {accepted}"
        );
    }
    Ok(())
}

/// Steps with these values for each Real input in turn.
pub fn with_inputs(subject: &Subject<'_>, values: &[f64]) -> Result<()> {
    let inputs = subject.inputs.iter().map(|input| input.variable);
    let inputs = inputs.filter(|v| v.of_type == Type::Float64).take(10);
    for (input, value) in inputs.flat_map(|input| values.iter().map(move |value| (input, *value))) {
        let name = quote(&input.name);
        subject.report.stage(format!("with {name} = {value}"));
        let mut run = Stepped.run(subject, subject.setup())?;
        if run.set(input, &[Value::Float64(value)]).is_err() {
            continue;
        }
        // The run sets its inputs itself, so steps are taken without it.
        if subject.kind == Kind::CoSimulation {
            let mut times = (1..4).map(|k| subject.start() + f64::from(k) * subject.step());
            let _ = times.try_for_each(|t| run.instance.do_step(t, subject.step()).map(drop));
        } else if subject.states() > 0 {
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
    let mut run = Stepped.run(subject, subject.setup())?;
    let unknown = unknown(subject);
    let refused = run.instance.get_float64(&[unknown], &mut [0.0]).is_err();
    if !refused || subject.library.is_lost() {
        return Ok(());
    }
    subject.report.stage("after fmi2Error and fmi2Reset");
    if let Err(error) = run.instance.reset() {
        report!(subject, AFTER_ERROR, "after fmi2Error, {error}");
        return Ok(());
    }
    run.initialize()?;
    run.advance()
}

/// Asks for the status of steps, and cancels one, though no step is asynchronous.
pub fn status(subject: &Subject<'_>) -> Result<()> {
    let mut run = Stepped.run(subject, subject.setup())?;
    let (mut time, mut status, mut text) = (0.0, fmi2::fmi2OK, std::ptr::null());
    let i = &mut run.instance;
    let _ = i.is_terminated();
    let _ = i.get_real_status(fmi2::fmi2LastSuccessfulTime, &mut time);
    let _ = i.get_status(fmi2::fmi2DoStepStatus, &mut status);
    let _ = i.get_string_status(fmi2::fmi2PendingStatus, &mut text);
    let _ = i.cancel_step();
    Ok(())
}
