//! Saving and restoring the state of an instance.

use anyhow::{Context, Result, ensure};
use fmu_description::Capability::{CanGetAndSetFMUstate, CanSerializeFMUstate};
use fmu_description::{Causality, ScalarVariable, Variability, VariableType};
use fmu_file::text::quote;
use fmu_host::State;

use crate::binary::excitation::other;
use crate::binary::record::{Value, read, set};
use crate::binary::rules::DAMAGED_STATE;
use crate::binary::run::Run;
use crate::binary::subject::{Setup, Subject};

/// Maximum size of a serialized state.
const MAX_BYTES: usize = 1 << 30;

/// Saves a state, runs on with other parameters, restores it, and runs the same again.
pub fn restore(subject: &Subject<'_>) -> Result<()> {
    if !subject.claims(CanGetAndSetFMUstate) {
        return Ok(());
    }
    let mut run = Run::begin(subject, &subject.setup())?;
    run.record(subject.steps)?;
    save_and_restore(subject, &mut run).context("canGetAndSetFMUstate is true, but")
}

fn save_and_restore<'a>(subject: &'a Subject<'a>, run: &mut Run<'a>) -> Result<()> {
    let place = run.place;
    let saved = run.instance.state()?;
    let before = everything(subject, run)?;
    let expected = run.record(subject.steps)?;
    tune(subject, run)?;
    // A second state must not overwrite the first.
    let later = run.instance.state()?;
    run.instance.free_state(later)?;
    if run.ended {
        run.instance.free_state(saved)?;
        return Ok(());
    }
    // Restored twice, as the first use must not change the state.
    for _ in 0..2 {
        run.instance.set_state(&saved)?;
        run.place = place;
        subject.report.stage("after the state was restored");
        for ((variable, before), (_, after)) in before.iter().zip(everything(subject, run)?) {
            ensure!(
                same(before, &after, subject.tolerance()),
                "{} is {after} after the state was restored, expected {before} as when it was saved",
                quote(variable.name)
            );
        }
        let actual = run.record(subject.steps)?;
        let when = "after steps from the restored state";
        subject.ensure_same(&actual, &expected, subject.tolerance(), when, " as before")?;
    }
    run.instance.free_state(saved)?;
    Ok(())
}

fn same(a: &Value, b: &Value, tolerance: f64) -> bool {
    match (a, b) {
        (Value::Real(a), Value::Real(b)) => {
            a == b || a.is_nan() && b.is_nan() || (a - b).abs() <= tolerance * a.abs().max(1e-9)
        }
        _ => a == b,
    }
}

/// The values of the observed variables, the inputs and the parameters.
fn everything<'a>(
    subject: &'a Subject<'a>,
    run: &mut Run<'_>,
) -> Result<Vec<(&'a ScalarVariable<'a>, Value)>> {
    let settable =
        |v: &&ScalarVariable<'_>| matches!(v.causality, Causality::Input | Causality::Parameter);
    let others = subject.all().filter(settable);
    let all = subject.observed.variables().chain(others);
    all.map(|v| Ok((v, read(&mut run.instance, v)?))).collect()
}

/// Changes tunable parameters and Strings, which belong to the state.
fn tune(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    let settable = subject.all().filter(|v| match v.causality {
        Causality::Parameter => v.variability == Variability::Tunable,
        // Other inputs change in the run.
        Causality::Input => v.kind == VariableType::String,
        _ => false,
    });
    for variable in settable {
        if let Some(value) = other(variable)
            && set(&mut run.instance, variable, &value).is_err()
        {
            break;
        }
    }
    Ok(())
}

/// Restores a state from bytes, in another instance.
pub fn serialize(subject: &Subject<'_>) -> Result<()> {
    if !subject.claims(CanGetAndSetFMUstate) || !subject.claims(CanSerializeFMUstate) {
        return Ok(());
    }
    through_bytes(subject).context("canSerializeFMUstate is true, but")
}

fn through_bytes(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, &subject.setup())?;
    run.record(subject.steps)?;
    let place = run.place;
    let bytes = bytes(&mut run)?;
    let expected = run.record(subject.steps)?;
    if run.ended {
        return Ok(());
    }
    let mut other = match subject.is_only_once() {
        true => run,
        false => {
            let setup = Setup {
                name: "other",
                seed: 2,
                ..subject.setup()
            };
            subject.report.stage("in another instance");
            let mut other = Run::begin(subject, &setup)?;
            other.record(3)?;
            other.continuing(subject.setup())
        }
    };
    let state = other.instance.deserialize(&bytes)?;
    other.instance.set_state(&state)?;
    other.instance.free_state(state)?;
    other.place = place;
    let actual = other.record(subject.steps)?;
    let when = "after steps from the state restored from bytes";
    subject.ensure_same(
        &actual,
        &expected,
        subject.tolerance(),
        when,
        " as in the first instance",
    )
}

fn bytes(run: &mut Run<'_>) -> Result<Vec<u8>> {
    let state: State = run.instance.state()?;
    let bytes = run.instance.serialize(&state, MAX_BYTES)?;
    run.instance.free_state(state)?;
    Ok(bytes)
}

/// Passes bytes that are not a serialized state.
pub fn damaged(subject: &Subject<'_>) -> Result<()> {
    if !subject.claims(CanGetAndSetFMUstate) || !subject.claims(CanSerializeFMUstate) {
        return Ok(());
    }
    let sound = bytes(&mut Run::begin(subject, &subject.setup())?)?;
    let mut cases: Vec<(String, Vec<u8>)> = vec![
        ("half of a state".into(), sound[..sound.len() / 2].to_vec()),
        (
            "a state with 8 more bytes".into(),
            [sound.as_slice(), &[0; 8]].concat(),
        ),
        ("255 in all bytes".into(), vec![255; sound.len()]),
    ];
    for part in 0..8 {
        let mut changed = sound.clone();
        let at = part * sound.len() / 8;
        if let Some(byte) = changed.get_mut(at) {
            *byte ^= 0x55;
            cases.push((format!("a state with byte {at} changed"), changed));
        }
    }
    let mut taken = Vec::new();
    for (what, bytes) in cases {
        subject.report.stage(format!("with damaged bytes: {what}"));
        let mut run = Run::begin(subject, &subject.setup())?;
        if let Ok(state) = run.instance.deserialize(&bytes) {
            // A copy of memory with pointers is only read when the state is used.
            let used = run.instance.set_state(&state).is_ok();
            if used {
                taken.push(what);
                let _ = run.advance();
            }
            if run.instance.free_state(state).is_err() {
                break;
            }
        }
    }
    if !taken.is_empty() {
        let text = format!(
            "fmi2DeSerializeFMUstate and fmi2SetFMUstate accepted bytes that are no serialized state: {}; expected an error",
            taken.join(", ")
        );
        subject.report.find(&DAMAGED_STATE, text);
    }
    Ok(())
}
