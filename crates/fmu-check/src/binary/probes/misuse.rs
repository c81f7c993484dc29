//! Calls that hosts must not make, or make only by mistake.

use std::collections::HashSet;

use anyhow::{Context, Result};
use fmu_description::{Causality, Listed, Type, Value, Variability};
use fmu_file::text::quote;
use fmu_host::{Kind, fmi2};

use super::runs::bytes;
use crate::binary::rules;
use crate::binary::run::{Run, Setup, Subject, readable};
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

/// Calls that the FMU must refuse.
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
        let mut run = at(self.subject, self.subject.setup())?;
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
const TYPES: [(&str, Type); 3] = [
    ("Real", Type::Float64),
    ("Integer", Type::Int32),
    ("Boolean", Type::Boolean),
];

/// Reads value references that do not exist, or have another type.
pub fn unknown_get(subject: &Subject<'_>) -> Result<()> {
    let accessed = |v: &Listed<'_>| v.of_type.accessed_as(subject.model.version);
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
    }
    refused.report(&rules::UNKNOWN_REFERENCE)
}

/// Writes value references that do not exist.
pub fn unknown_set(subject: &Subject<'_>) -> Result<()> {
    let unknown = unknown(subject);
    let mut refused = Refused::new(subject);
    for (name, of_type) in TYPES {
        let what = format!("fmi2Set{name} for the unknown value reference {unknown}");
        refused.call(what, Run::begin, |run| {
            (run.instance).set_values(of_type, &[unknown], &[Value::Boolean(false)])
        })?;
    }
    refused.report(&rules::UNKNOWN_REFERENCE)
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
            refused.call(what, Run::stepped, |run| run.set(variable, &[value]))?;
        }
    }
    refused.report(&rules::SETTABLE)
}

/// Makes calls that the FMU must refuse: what each is, the run in which it is made, and the call.
macro_rules! refuse {
    ($subject:ident, $rule:ident: $($what:literal, $at:expr, $call:expr;)*) => {{
        let mut refused = Refused::new($subject);
        $(refused.call($what, $at, $call)?;)*
        refused.report(&rules::$rule)
    }};
}

/// Takes steps with a wrong size or time.
pub fn step_arguments(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, STEP_ARGUMENTS:
        "fmi2DoStep with a negative step size", Run::stepped, |run| run.do_step(1.0, -1.0);
        "fmi2DoStep with a time before the current one", Run::stepped, |run| run.do_step(0.0, 1.0);
        "fmi2DoStep with a time after the current one", Run::stepped, |run| run.do_step(101.0, 1.0);
    }
}

/// Takes steps with invalid numbers.
pub fn step_nan(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, STEP_ARGUMENTS:
        "fmi2DoStep with a step size of NaN", Run::stepped, |run| run.do_step(1.0, f64::NAN);
        "fmi2DoStep with an infinite step size", Run::stepped, |run| run.do_step(1.0, f64::INFINITY);
        "fmi2DoStep with a time of NaN", Run::stepped, |run| run.do_step(f64::NAN, 1.0);
    }
}

/// Makes calls in a wrong order.
pub fn order(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, ORDER:
        "fmi2ExitInitializationMode before fmi2EnterInitializationMode", Run::instantiate,
            |run| run.instance.exit_initialization_mode();
        "fmi2EnterInitializationMode after initialization", Run::stepped,
            |run| run.instance.enter_initialization_mode();
    }
}

/// Sets up the experiment a second time.
pub fn order_of_setup(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, ORDER:
        "fmi2SetupExperiment after initialization", Run::stepped,
            |run| run.instance.setup_experiment(subject.start, None, None);
    }
}

/// Takes steps before initialization and after the end.
pub fn order_of_steps(subject: &Subject<'_>) -> Result<()> {
    refuse! { subject, ORDER:
        "fmi2DoStep before initialization", Run::instantiate, |run| run.do_step(0.0, 1.0);
        "fmi2DoStep in initialization mode", Run::initializing, |run| run.do_step(0.0, 1.0);
        "fmi2DoStep after fmi2Terminate", Run::terminated, |run| run.do_step(1.0, 1.0);
    }
}

/// Takes a step beyond the stop time.
pub fn past_stop(subject: &Subject<'_>) -> Result<()> {
    let stop = Some(subject.start + 2.0 * subject.step);
    refuse! { subject, PAST_STOP:
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
        let n = variable.count();
        for wrong in [n + 1, n.saturating_sub(1)] {
            let name = quote(&variable.name);
            let what = format!("reading {wrong} values of {name}, which has {n}");
            refused.call(what, Run::begin, |run| run.read_elements(variable, wrong))?;
        }
    }
    refused.report(&rules::ARRAY_LENGTHS)
}

/// Passes bytes that are not a serialized state.
pub fn damaged_state(subject: &Subject<'_>) -> Result<()> {
    let sound = bytes(&mut Run::begin(subject, subject.setup())?)?;
    let mut cases: Vec<(String, Vec<u8>)> = vec![
        ("half of a state".into(), sound[..sound.len() / 2].to_vec()),
        (
            "a state with 8 more bytes".into(),
            [sound.as_slice(), &[0; 8]].concat(),
        ),
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
        let what = format!("fmi2SetFMUstate with damaged bytes: {is}");
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
    refused.report(&rules::DAMAGED_STATE)
}

/// Steps with these values for each Real input in turn.
pub fn with_inputs(subject: &Subject<'_>, values: &[f64]) -> Result<()> {
    let inputs = subject.inputs.iter().map(|input| input.variable);
    let inputs = inputs.filter(|v| v.of_type == Type::Float64).take(10);
    for (input, value) in inputs.flat_map(|input| values.iter().map(move |value| (input, *value))) {
        let name = quote(&input.name);
        subject.report.stage(format!("with {name} = {value}"));
        let mut run = Run::stepped(subject, subject.setup())?;
        if run.set(input, &[Value::Float64(value)]).is_err() {
            continue;
        }
        // The run sets its inputs itself, so steps are taken without it.
        if subject.kind == Kind::CoSimulation {
            let _ = (1..4).try_for_each(|k| run.do_step(f64::from(k), 1.0).map(drop));
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
    let _ = i.get_real_status(fmi2::fmi2LastSuccessfulTime, &mut time);
    let _ = i.get_status(fmi2::fmi2DoStepStatus, &mut status);
    let _ = i.get_string_status(fmi2::fmi2PendingStatus, &mut text);
    let _ = i.cancel_step();
    Ok(())
}
