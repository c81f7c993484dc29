//! Saving, restoring and resetting the state of an instance.

use anyhow::{Result, bail, ensure};
use fmu_description::{Causality, Type, Variability};

use super::OrSkip;
use crate::binary::inputs::other;
use crate::binary::rules::DAMAGED_STATE;
use crate::binary::run::Run;
use crate::binary::subject::Subject;
use crate::binary::values::{Observed, Row, element_name};

/// Maximum size of a serialized state.
const MAX_BYTES: usize = 1 << 30;

/// Saves a state, runs on with other parameters, restores it, and runs the same again.
pub fn restore(subject: &Subject<'_>) -> Result<()> {
    let tolerance = subject.tolerance();
    let mut run = Run::begin(subject, subject.setup())?;
    run.record()?;
    let place = run.place;
    let saved = run.instance.get_fmu_state()?;
    let all = everything(subject);
    let before = vec![(run.time(), all.read(&mut run.instance)?)];
    let expected = run.record()?;
    tune(subject, &mut run);
    // A second state must not overwrite the first.
    let later = run.instance.get_fmu_state()?;
    run.instance.free_fmu_state(later)?;
    // Restored twice, as the first use must not change the state.
    for _ in 0..2 {
        if run.ended {
            break;
        }
        run.instance.set_fmu_state(&saved)?;
        run.place = place;
        let when = "after the state was restored";
        subject.report.stage(when);
        let after: Row = all.read(&mut run.instance)?;
        let after = vec![(run.time(), after)];
        if let Some(difference) = all.difference(&after, &before, tolerance) {
            bail!(difference.told(when, " as when it was saved"));
        }
        let actual = run.record()?;
        let when = "after steps from the restored state";
        subject.ensure_same(&actual, &expected, tolerance, when, " as before")?;
    }
    run.instance.free_fmu_state(saved)?;
    Ok(())
}

/// The observed variables, the inputs and the parameters.
fn everything<'a>(subject: &Subject<'a>) -> Observed<'a> {
    let all = subject.observed.variables().chain(subject.settable());
    Observed::of(all, subject.model.version)
}

/// Changes tunable parameters and Strings, which belong to the state.
fn tune(subject: &Subject<'_>, run: &mut Run<'_>) {
    let belongs = subject.settable().filter(|v| match v.causality {
        Causality::Parameter => v.variability == Variability::Tunable,
        // Other inputs change in the run.
        _ => v.of_type == Type::String,
    });
    for variable in belongs {
        if let Some(value) = other(variable)
            && run.set(variable, &[value]).is_err()
        {
            break;
        }
    }
}

/// Restores a state from bytes, in another instance.
pub fn serialize(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    run.record()?;
    let place = run.place;
    let bytes = bytes(&mut run)?;
    let expected = run.record()?;
    if run.ended {
        return Ok(());
    }
    let mut other = run;
    if !subject.is_only_once() {
        subject.report.stage("in another instance");
        other = Run::begin(subject, subject.other().with(|s| s.seed = 2))?;
        other.advance_by(3)?;
        other.observe()?;
        other.setup = subject.setup();
    }
    let state = other.instance.deserialize_fmu_state(&bytes)?;
    other.instance.set_fmu_state(&state)?;
    other.instance.free_fmu_state(state)?;
    other.place = place;
    let actual = other.record()?;
    let when = "after steps from the state restored from bytes";
    let like = " as in the first instance";
    subject.ensure_same(&actual, &expected, subject.tolerance(), when, like)
}

fn bytes(run: &mut Run<'_>) -> Result<Vec<u8>> {
    let state = run.instance.get_fmu_state()?;
    let bytes = run.instance.serialize_fmu_state(&state, MAX_BYTES)?;
    run.instance.free_fmu_state(state)?;
    Ok(bytes)
}

/// Passes bytes that are not a serialized state.
pub fn damaged(subject: &Subject<'_>) -> Result<()> {
    let sound = bytes(&mut Run::begin(subject, subject.setup())?)?;
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
        let mut run = Run::begin(subject, subject.setup())?;
        if let Ok(state) = run.instance.deserialize_fmu_state(&bytes) {
            // A copy of memory with pointers is only read when the state is used.
            if run.instance.set_fmu_state(&state).is_ok() {
                taken.push(what);
                let _ = run.advance();
            }
            if run.instance.free_fmu_state(state).is_err() {
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

/// Changes the start values of all inputs and parameters, resets, and reads them.
pub fn reset_values(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::instantiate(subject, subject.setup())?;
    for variable in subject.settable() {
        if let Some(value) = other(variable) {
            run.set(variable, &[value]).or_skip()?;
        }
    }
    subject.report.stage("after fmi2Reset");
    let mut run = run.reset()?;
    run.enter_initialization()?;
    let mut new = Run::initializing(subject, subject.other())?;
    for variable in subject.settable() {
        let (expected, actual) = (new.value(variable)?, run.value(variable)?);
        let name = element_name(variable, 0);
        ensure!(
            actual == expected,
            "after fmi2Reset, {name} is {actual}, expected its start value {expected}"
        );
    }
    Ok(())
}
