//! Calls that hosts make by mistake: the FMU refuses them, and does not crash.

use std::collections::HashSet;

use anyhow::{Context, Result, ensure};
use fmu_description::{Causality, Type, Value, Variability, XmlVariable};
use fmu_file::text::quote;
use fmu_host::{InterfaceType, fmi2};

use super::runs::{bytes, reset_and_run};
use crate::binary::excitation::other_value;
use crate::binary::observed::{Difference, is_tested, readable};
use crate::binary::report::check;
use crate::binary::run::Run;
use crate::binary::subject::{RunSetup, SKIP, Subject};
use crate::rule::{Rule, rule};

/// A GUID of another FMU.
pub const WRONG_GUID: &str = "{00000000-0000-0000-0000-000000000000}";

/// Passes the GUID of another FMU.
pub fn guid(subject: &Subject<'_>) -> Result<()> {
    let instance = subject.try_instantiate(&subject.setup(), WRONG_GUID)?;
    check!(subject, "guid-checked": instance.is_none(),
        "fmi2Instantiate accepted the GUID of another FMU, expected NULL: a mismatch of XML and binary \
         would go unnoticed");
    Ok(())
}

/// Makes mistakes about which an FMU should log a message, unless it crashes then, which is a finding of
/// its own.
pub fn provoke(subject: &Subject<'_>, setup: RunSetup<'_>) {
    if !subject.task.is_fragile {
        make_mistakes(subject, setup);
    }
}

/// Finds out whether mistakes crash the FMU.
pub fn mistakes(subject: &Subject<'_>) -> Result<()> {
    make_mistakes(subject, subject.setup());
    Ok(())
}

fn make_mistakes(subject: &Subject<'_>, setup: RunSetup<'_>) {
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
pub fn unknown(subject: &Subject<'_>) -> u32 {
    let variables = subject.model.variables();
    let known: HashSet<u32> = variables.map(|(_, v)| v.reference).collect();
    // Not the largest, which may stand for "none".
    let mut candidates = (0..u32::MAX - 7).rev();
    let unknown = candidates.find(|reference| !known.contains(reference));
    unknown.unwrap_or_default()
}

/// Calls that the FMU must refuse.
pub struct Refused<'a> {
    subject: &'a Subject<'a>,
    accepted: Vec<String>,
}

impl<'a> Refused<'a> {
    pub fn new(subject: &'a Subject<'a>) -> Self {
        Self { subject, accepted: Vec::new() }
    }

    /// Makes a call in a new run; `what` tells function and circumstances, such as `fmi2DoStep before
    /// initialization`.
    pub fn call<T, E>(
        &mut self,
        what: impl Into<String>,
        at: impl FnOnce(&'a Subject<'a>, RunSetup<'a>) -> Result<Run<'a>>,
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

    pub fn report(self, rule: &Rule) -> Result<()> {
        if !self.accepted.is_empty() {
            let calls = self.accepted.join("; ");
            let text = format!("these calls returned fmi2OK, expected fmi2Error: {calls}");
            self.subject.report.add_finding(rule, text);
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
            Parameter => other_value(variable),
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
pub(super) use refuse;

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
        InterfaceType::ModelExchange => run.derivatives().map(drop),
        _ => run.do_step(1.0, 1.0).map(drop),
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
