//! Several instances, and several threads.

use std::ffi::CString;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, ensure};
use fmu_description::{Causality, ScalarVariable, VariableType};

use crate::binary::record::Trajectory;
use crate::binary::run::Run;
use crate::binary::subject::{Setup, Subject};

/// Relative difference of results that must be equal but for the rounding of vectorized loops.
const ROUNDING: f64 = 1e-9;

fn usual(subject: &Subject<'_>) -> Result<Trajectory> {
    Run::recorded(subject, &subject.setup())
}

fn as_alone(
    subject: &Subject<'_>,
    actual: &Trajectory,
    expected: &Trajectory,
    when: &str,
) -> Result<()> {
    subject.ensure_same(actual, expected, ROUNDING, when, " as alone")
}

/// Another excitation than the usual one.
fn other<'a>(subject: &Subject<'_>) -> Setup<'a> {
    Setup {
        name: "other",
        seed: 3,
        ..subject.setup()
    }
}

/// Runs an instance alone, and again next to a second instance with other inputs and parameters.
pub fn beside(subject: &Subject<'_>) -> Result<()> {
    if subject.is_only_once() {
        return Ok(());
    }
    let expected = usual(subject)?;
    let when = "canBeInstantiatedOnlyOncePerProcess is false, but with a second instance";
    subject.report.stage("with a second instance");
    let changed = Setup {
        parameters: true,
        ..other(subject)
    };
    let mut one = Run::begin(subject, &subject.setup())?;
    let mut two =
        Run::begin(subject, &changed).or_else(|_| Run::begin(subject, &other(subject)))?;
    let rows = one.record_by(subject.steps, |one| {
        two.advance()?;
        one.advance()?;
        one.ended |= two.ended;
        Ok(())
    })?;
    as_alone(subject, &rows, &expected, when)
}

/// Runs a new instance after another one was freed.
pub fn after(subject: &Subject<'_>) -> Result<()> {
    let expected = usual(subject)?;
    let mut run = Run::begin(subject, &other(subject))?;
    run.record(subject.steps)?;
    drop(run);
    subject.report.stage("after another instance was freed");
    as_alone(
        subject,
        &usual(subject)?,
        &expected,
        "after another instance was freed",
    )
}

/// Runs on a thread that has not created the instance.
pub fn on_another_thread(subject: &Subject<'_>) -> Result<()> {
    let expected = usual(subject)?;
    let mut run = Run::begin(subject, &subject.setup())?;
    subject.report.stage("on another thread");
    let actual = thread::scope(|scope| {
        let rows = scope.spawn(|| run.record(subject.steps));
        rows.join()
            .map_err(|_| anyhow!("the thread has ended early"))?
    })?;
    as_alone(subject, &actual, &expected, "on another thread")
}

/// Runs two instances on two threads at the same time, again and again for a while.
pub fn at_the_same_time(subject: &Subject<'_>) -> Result<()> {
    const DURATION: Duration = Duration::from_millis(500);
    if subject.is_only_once() {
        return Ok(());
    }
    let alone = |setup: &Setup<'static>| Run::recorded(subject, setup);
    let setups = [subject.setup(), other(subject)];
    let expected = [alone(&setups[0])?, alone(&setups[1])?];
    subject
        .report
        .stage("with another instance on another thread");
    let begin = Instant::now();
    while begin.elapsed() < DURATION {
        let actual = thread::scope(|scope| {
            let threads = setups.map(|setup| scope.spawn(move || alone(&setup)));
            threads.map(|thread| thread.join())
        });
        for (actual, expected) in actual.into_iter().zip(&expected) {
            let actual = actual.map_err(|_| anyhow!("a thread has ended early"))??;
            as_alone(
                subject,
                &actual,
                expected,
                "with another instance on another thread",
            )?;
        }
    }
    Ok(())
}

/// The strings of an instance stay when another instance sets and gets its own.
pub fn strings(subject: &Subject<'_>) -> Result<()> {
    let is_string = |v: &&ScalarVariable<'_>| v.kind == VariableType::String;
    let readable = subject.observed.variables().filter(|v| is_string(v));
    let references: Vec<u32> = readable.map(|v| v.reference).collect();
    if references.is_empty() || subject.is_only_once() {
        return Ok(());
    }
    let mut one = Run::begin(subject, &subject.setup())?;
    let mut two = Run::instantiate(subject, &other(subject))?;
    let text = [CString::new("another text")?];
    for variable in subject.variables(Causality::Parameter).filter(is_string) {
        if two
            .instance
            .set_string(&[variable.reference], &text)
            .is_err()
        {
            return Ok(());
        }
    }
    if two.initialize().is_err() {
        // A text may be more than a text, such as the name of a file.
        return Ok(());
    }
    one.advance()?;
    let expected = one.instance.get_string(&references)?;
    subject
        .report
        .stage("after strings of another instance were read");
    let late = one.instance.get_string_late(&references, || {
        let _ = two.advance();
        let _ = two.instance.get_string(&references);
    })?;
    for (late, expected) in late.into_iter().zip(expected) {
        ensure!(
            late.as_ref() == Some(&expected),
            "a string changed from {expected:?} to {late:?} when strings of another instance were read"
        );
    }
    Ok(())
}
