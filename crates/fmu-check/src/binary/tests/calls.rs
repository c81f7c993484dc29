//! Calls that hosts must not make, or make only by mistake.

use std::collections::HashSet;

use anyhow::Result;
use fmu_description::{Causality, FmiVersion, ScalarVariable, Variability, VariableType};
use fmu_file::text::quote;
use fmu_host::{Instance, Kind};

use crate::binary::excitation::other;
use crate::binary::record::Value;
use crate::binary::rules::{
    AFTER_ERROR, ORDER, PAST_STOP, SETTABLE, STEP_ARGUMENTS, UNKNOWN_REFERENCE,
};
use crate::binary::run::Run;
use crate::binary::subject::{Setup, Subject, is_real, is_tested};

/// Makes mistakes about which an FMU should log a message, unless it crashes then, which is a finding of
/// its own.
pub fn provoke(subject: &Subject<'_>, setup: &Setup<'_>) {
    if !subject.is_fragile {
        make_mistakes(subject, setup);
    }
}

/// Finds out whether mistakes crash the FMU.
pub fn mistakes(subject: &Subject<'_>) -> Result<()> {
    make_mistakes(subject, &subject.setup());
    Ok(())
}

fn make_mistakes(subject: &Subject<'_>, setup: &Setup<'_>) {
    let unknown = unknown(subject);
    if let Ok(mut run) = Run::instantiate(subject, setup) {
        let _ = run.instance.get_real(&[unknown], &mut [0.0]);
    }
    if let Ok(mut run) = Run::instantiate(subject, setup) {
        let _ = run.instance.do_step(0.0, -1.0);
    }
    if let Ok(mut run) = Run::instantiate(subject, setup) {
        let _ = run.initialize();
        let _ = run.instance.set_real(&[unknown], &[0.0]);
    }
}

/// A value reference that no variable has.
fn unknown(subject: &Subject<'_>) -> u32 {
    let known: HashSet<u32> = subject
        .model
        .variables()
        .map(|(_, v)| v.reference)
        .collect();
    // Not the largest, which may stand for "none".
    let mut candidates = (0..u32::MAX - 7).rev();
    candidates
        .find(|reference| !known.contains(reference))
        .unwrap_or_default()
}

/// Runs steps with a special value for each Real input in turn.
fn with_inputs(subject: &Subject<'_>, values: &[f64]) -> Result<()> {
    let inputs: Vec<_> = (subject.inputs.iter())
        .map(|input| input.variable)
        .filter(|v| is_real(v))
        .take(10)
        .collect();
    for input in inputs {
        for value in values {
            let name = quote(input.name);
            subject.report.stage(format!("with {name} = {value}"));
            let mut run = Run::begin(subject, &subject.setup())?;
            run.advance()?;
            if run
                .instance
                .set_real(&[input.reference], &[*value])
                .is_err()
            {
                continue;
            }
            // The run sets its inputs itself, so steps are taken without it.
            if subject.kind == Kind::CoSimulation {
                for k in 1..4 {
                    let time = subject.start() + f64::from(k) * subject.step();
                    if run.instance.do_step(time, subject.step()).is_err() {
                        break;
                    }
                }
            } else if subject.states() > 0 {
                let _ = run.instance.derivatives(subject.states());
            }
            if !run.ended {
                let _ = run.observe();
            }
        }
    }
    Ok(())
}

pub fn nan(subject: &Subject<'_>) -> Result<()> {
    with_inputs(subject, &[f64::NAN])
}

pub fn infinity(subject: &Subject<'_>) -> Result<()> {
    with_inputs(subject, &[f64::INFINITY, f64::NEG_INFINITY, 1e300])
}

/// Reports the calls that were accepted.
fn report(subject: &Subject<'_>, rule: &crate::Rule, accepted: &[String]) {
    if !accepted.is_empty() {
        let text = format!(
            "these calls returned fmi2OK, expected fmi2Error: {}",
            accepted.join("; ")
        );
        subject.report.find(rule, text);
    }
}

type Access = fn(&mut Instance, u32) -> fmu_host::Result;

const GET: [(&str, VariableType, Access); 3] = [
    ("fmi2GetReal", VariableType::Real, |i, r| {
        i.get_real(&[r], &mut [0.0])
    }),
    ("fmi2GetInteger", VariableType::Integer, |i, r| {
        i.get_integer(&[r], &mut [0])
    }),
    ("fmi2GetBoolean", VariableType::Boolean, |i, r| {
        i.get_boolean(&[r], &mut [0])
    }),
];

const SET: [(&str, VariableType, Access); 3] = [
    ("fmi2SetReal", VariableType::Real, |i, r| {
        i.set_real(&[r], &[0.0])
    }),
    ("fmi2SetInteger", VariableType::Integer, |i, r| {
        i.set_integer(&[r], &[0])
    }),
    ("fmi2SetBoolean", VariableType::Boolean, |i, r| {
        i.set_boolean(&[r], &[0])
    }),
];

/// Reads value references that do not exist, or have another type.
pub fn unknown_get(subject: &Subject<'_>) -> Result<()> {
    let mut accepted = with_unknown(subject, &GET)?;
    let variables = subject.model.variables();
    let known: HashSet<_> = variables
        .map(|(_, v)| (class(v.kind), v.reference))
        .collect();
    for (function, kind, get) in GET {
        let others = subject.model.variables().map(|(_, v)| v).filter(|v| {
            class(v.kind) != kind
                && is_tested(v)
                && v.kind != VariableType::Enumeration
                && !known.contains(&(kind, v.reference))
        });
        for variable in first_of_types(others) {
            let name = quote(variable.name);
            subject
                .report
                .stage(format!("for {name}, which has another type"));
            let mut run = Run::begin(subject, &subject.setup())?;
            if get(&mut run.instance, variable.reference).is_ok() {
                accepted.push(format!("{function} for {name}, which has another type"));
            }
        }
    }
    report(subject, &UNKNOWN_REFERENCE, &accepted);
    Ok(())
}

/// The type of FMI 2.0 whose functions, or those of FMI 3.0 that replace them, access a type.
fn class(kind: VariableType) -> VariableType {
    match kind {
        VariableType::Float64 => VariableType::Real,
        VariableType::Int32 => VariableType::Integer,
        kind => kind.accessed_as(),
    }
}

/// The first variable of each type.
fn first_of_types<'b, 'a: 'b>(
    variables: impl Iterator<Item = &'b ScalarVariable<'a>>,
) -> Vec<&'b ScalarVariable<'a>> {
    let mut first: Vec<&ScalarVariable<'_>> = Vec::new();
    for variable in variables {
        if first.iter().all(|other| other.kind != variable.kind) {
            first.push(variable);
        }
    }
    first
}

/// Writes value references that do not exist.
pub fn unknown_set(subject: &Subject<'_>) -> Result<()> {
    let accepted = with_unknown(subject, &SET)?;
    report(subject, &UNKNOWN_REFERENCE, &accepted);
    Ok(())
}

fn with_unknown(
    subject: &Subject<'_>,
    calls: &[(&str, VariableType, Access)],
) -> Result<Vec<String>> {
    let reference = unknown(subject);
    let mut accepted = Vec::new();
    for (function, _, call) in calls {
        subject
            .report
            .stage(format!("for the unknown value reference {reference}"));
        let mut run = Run::begin(subject, &subject.setup())?;
        if call(&mut run.instance, reference).is_ok() {
            accepted.push(format!(
                "{function} for the unknown value reference {reference}"
            ));
        }
    }
    Ok(accepted)
}

/// Value references of the states of model exchange, which some hosts, such as CasADi, set one by one.
fn states(subject: &Subject<'_>) -> Vec<u32> {
    if subject.kind != Kind::ModelExchange {
        return Vec::new();
    }
    let model = subject.model;
    let state = |v: &ScalarVariable<'_>| {
        let of: u32 = v.value.attribute("derivative")?.parse().ok()?;
        match model.version {
            FmiVersion::Fmi2 => Some(model.variable(of as usize)?.reference),
            FmiVersion::Fmi3 => Some(of),
        }
    };
    model.variables().filter_map(|(_, v)| state(v)).collect()
}

/// Sets what the XML does not allow to set.
pub fn settable(subject: &Subject<'_>) -> Result<()> {
    let mut accepted = Vec::new();
    let mut attempt = |variable: &ScalarVariable<'_>, what: &str, value: f64| -> Result<()> {
        subject
            .report
            .stage(format!("for {}, {what}", quote(variable.name)));
        let mut run = Run::begin(subject, &subject.setup())?;
        run.advance()?;
        if run
            .instance
            .set_real(&[variable.reference], &[value])
            .is_ok()
        {
            accepted.push(format!(
                "fmi2SetReal after initialization for {}, {what}",
                quote(variable.name)
            ));
        }
        Ok(())
    };
    let states = states(subject);
    let first = |causality, variability| {
        subject
            .variables(causality)
            .filter(|v| !states.contains(&v.reference))
            .find(|v| v.variability == variability && is_real(v))
    };
    if let Some(v) = first(Causality::Output, Variability::Continuous) {
        attempt(v, "an output", 0.0)?;
    }
    if let Some(v) = first(Causality::Output, Variability::Discrete) {
        attempt(v, "an output", 0.0)?;
    }
    if let Some(v) = first(Causality::Parameter, Variability::Fixed)
        && let Some(Value::Real(value)) = other(v)
    {
        attempt(v, "a fixed parameter", value)?;
    }
    for causality in [Causality::Output, Causality::Local] {
        if let Some(v) = first(causality, Variability::Constant) {
            attempt(v, "a constant", 0.0)?;
        }
    }
    if let Some(v) = first(Causality::CalculatedParameter, Variability::Fixed) {
        attempt(v, "a calculated parameter", 0.0)?;
    }
    report(subject, &SETTABLE, &accepted);
    Ok(())
}

/// Takes steps with a wrong size or time.
pub fn step_arguments(subject: &Subject<'_>) -> Result<()> {
    let (start, step) = (subject.start(), subject.step());
    let wrong = [
        ("a negative step size", start + step, -step),
        ("a time before the current one", start, step),
        ("a time after the current one", start + 100.0 * step, step),
    ];
    steps(subject, &wrong)
}

/// Takes steps with invalid numbers.
pub fn step_nan(subject: &Subject<'_>) -> Result<()> {
    let (start, step) = (subject.start(), subject.step());
    let wrong = [
        ("a step size of NaN", start + step, f64::NAN),
        ("an infinite step size", start + step, f64::INFINITY),
        ("a time of NaN", f64::NAN, step),
    ];
    steps(subject, &wrong)
}

fn steps(subject: &Subject<'_>, wrong: &[(&str, f64, f64)]) -> Result<()> {
    if subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let mut accepted = Vec::new();
    for (what, time, step) in wrong {
        subject.report.stage(format!("with {what}"));
        let mut run = Run::begin(subject, &subject.setup())?;
        run.advance()?;
        if run.ended {
            return Ok(());
        }
        if run.instance.do_step(*time, *step).is_ok() {
            accepted.push(format!("fmi2DoStep with {what}"));
        }
    }
    report(subject, &STEP_ARGUMENTS, &accepted);
    Ok(())
}

/// Makes calls in a wrong order.
pub fn order(subject: &Subject<'_>) -> Result<()> {
    let (start, step) = (subject.start(), subject.step());
    let mut accepted = Vec::new();
    let mut attempt = |what: &str, taken: bool| {
        if taken {
            accepted.push(what.to_owned());
        }
    };
    let new = |what: &str| {
        subject.report.stage(what.to_owned());
        Run::instantiate(subject, &subject.setup())
    };
    let begun = |what: &str| -> Result<Run<'_>> {
        let mut run = Run::begin(subject, &subject.setup())?;
        run.advance()?;
        subject.report.stage(what.to_owned());
        Ok(run)
    };
    if subject.kind == Kind::CoSimulation {
        let what = "fmi2DoStep before initialization";
        attempt(what, new(what)?.instance.do_step(start, step).is_ok());
        let what = "fmi2DoStep in initialization mode";
        let mut run = new(what)?;
        run.enter_initialization()?;
        attempt(what, run.instance.do_step(start, step).is_ok());
        drop(run);
        let what = "fmi2DoStep after fmi2Terminate";
        let mut run = begun(what)?;
        if !run.ended {
            run.instance.terminate()?;
            attempt(what, run.instance.do_step(start + step, step).is_ok());
        }
        drop(run);
    }
    let what = "fmi2ExitInitializationMode before fmi2EnterInitializationMode";
    attempt(what, new(what)?.instance.exit_initialization_mode().is_ok());
    let what = "fmi2EnterInitializationMode after initialization";
    attempt(
        what,
        begun(what)?.instance.enter_initialization_mode().is_ok(),
    );
    if subject.model.version == FmiVersion::Fmi2 {
        let what = "fmi2SetupExperiment after initialization";
        let mut run = begun(what)?;
        attempt(
            what,
            run.instance.setup_experiment(start, None, None).is_ok(),
        );
    }
    report(subject, &ORDER, &accepted);
    Ok(())
}

/// Resets an instance after an error.
pub fn after_error(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, &subject.setup())?;
    run.advance()?;
    let unknown = unknown(subject);
    if run.instance.get_real(&[unknown], &mut [0.0]).is_ok() || subject.library.is_lost() {
        return Ok(());
    }
    subject.report.stage("after fmi2Error and fmi2Reset");
    if let Err(error) = run.instance.reset() {
        subject
            .report
            .find(&AFTER_ERROR, format!("after fmi2Error, {error}"));
        return Ok(());
    }
    run.initialize()?;
    run.advance()?;
    Ok(())
}

/// Asks for the status of steps, and cancels one, though no step is asynchronous.
pub fn status(subject: &Subject<'_>) -> Result<()> {
    if subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let mut run = Run::begin(subject, &subject.setup())?;
    run.advance()?;
    let _ = run.instance.is_terminated();
    let _ = run.instance.last_successful_time();
    let _ = run.instance.pending_status();
    let _ = run.instance.cancel_step();
    Ok(())
}

/// Takes a step beyond the stop time.
pub fn past_stop(subject: &Subject<'_>) -> Result<()> {
    if subject.kind == Kind::ModelExchange {
        return Ok(());
    }
    let setup = Setup {
        stop: Some(subject.start() + 2.0 * subject.step()),
        ..subject.setup()
    };
    subject.report.stage("with a step beyond the stop time");
    let mut run = Run::begin(subject, &setup)?;
    run.advance()?;
    run.advance()?;
    let taken = run.instance.do_step(run.time(), subject.step()).is_ok();
    if taken && !run.ended {
        let what = "fmi2DoStep beyond the stop time";
        report(subject, &PAST_STOP, &[what.to_owned()]);
    }
    Ok(())
}
