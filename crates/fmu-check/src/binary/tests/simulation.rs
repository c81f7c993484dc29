//! Runs of the default experiment, in several ways.

use std::collections::HashSet;
use std::ops::RangeInclusive;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use fmu_description::value::real;
use fmu_description::{Capability, Causality, ScalarVariable, Variability, VariableType};
use fmu_file::text::quote;
use fmu_host::Kind;

use crate::binary::child::is_refusal;
use crate::binary::excitation::{Level, integer_range, numbers, other};
use crate::binary::record::{Digests, Row, Trajectory, Value, read, set};
use crate::binary::rules::{BOUNDS, CONSTANT, FINITE, STEADY_TIME, VALID_VALUES};
use crate::binary::run::Run;
use crate::binary::subject::{Setup, Subject};

/// Runs the default experiment to its end, or as far as half of the time limit allows. Reports how many
/// steps were taken and how long they took, or why the FMU refused the excitation.
pub fn experiment(subject: &Subject<'_>) -> Result<()> {
    /// Euler steps that solve stiffer models.
    const FINE: usize = 200;
    let usual = subject.setup();
    let mut outcome = Outcome::of(subject, &usual);
    if outcome.is_doubtful() && subject.kind == Kind::ModelExchange && subject.level == Level::Still
    {
        let fine = Setup {
            parts: FINE,
            ..usual
        };
        outcome = Outcome::of(subject, &fine);
    }
    if outcome.is_doubtful() && subject.level != Level::Still {
        // Inputs outside the model's range of validity; a weaker excitation decides.
        subject.report.value("refused");
        return Ok(());
    }
    let steps = outcome.steps?;
    let seconds = outcome.seconds;
    subject.report.value(&format!("steps {steps} {seconds}"));
    outcome.watch.report(subject);
    Ok(())
}

/// The outcome of a run to the end.
struct Outcome<'a> {
    watch: Watch<'a>,
    steps: Result<usize>,
    seconds: f64,
}

impl<'a> Outcome<'a> {
    fn of(subject: &'a Subject<'a>, setup: &Setup<'a>) -> Self {
        let begin = Instant::now();
        let mut watch = Watch::new(subject);
        let steps = watched(subject, setup, &mut watch);
        let seconds = begin.elapsed().as_secs_f64();
        Self {
            watch,
            steps,
            seconds,
        }
    }

    /// Whether the FMU has refused to go on, or computed what is not a number, which may be due to the
    /// inputs or to our solver.
    fn is_doubtful(&self) -> bool {
        self.watch.has_nan || self.steps.as_ref().is_err_and(is_refusal)
    }
}

fn watched<'a>(
    subject: &'a Subject<'a>,
    setup: &Setup<'a>,
    watch: &mut Watch<'a>,
) -> Result<usize> {
    let mut run = Run::begin(subject, setup)?;
    let constants: Vec<_> = constants(subject).collect();
    let values = |run: &mut Run<'_>| -> Result<Vec<Value>> {
        constants
            .iter()
            .map(|v| read(&mut run.instance, v))
            .collect()
    };
    let before = values(&mut run)?;
    let mut times = Vec::new();
    let steps = run.run_for(subject.all_steps(), subject.time_limit / 2, |time, row| {
        times.push(Instant::now());
        watch.push(time, row);
    })?;
    slows_down(subject, steps, &times);
    if !run.ended {
        for ((variable, before), after) in constants.iter().zip(before).zip(values(&mut run)?) {
            if before != after {
                let name = quote(variable.name);
                watch.found.push((
                    &CONSTANT,
                    format!("{name} is {after} at the end of the run, expected {before} as after initialization"),
                ));
            }
        }
    }
    run.instance.terminate()?;
    Ok(steps)
}

/// Compares the durations of the parts of a run.
fn slows_down(subject: &Subject<'_>, steps: usize, times: &[Instant]) {
    const PARTS: usize = 4;
    /// How much longer the last part must take than the first.
    const FACTOR: f64 = 4.0;
    if steps < 20 * PARTS {
        return;
    }
    // The median, since the system may interrupt any step.
    let median = |part: usize| {
        let range = part * steps / PARTS..(part + 1) * steps / PARTS;
        let mut durations: Vec<f64> = range
            .filter_map(|k| Some(times.get(k + 1)?.duration_since(times[k]).as_secs_f64()))
            .collect();
        durations.sort_by(f64::total_cmp);
        durations.get(durations.len() / 2).copied().unwrap_or(0.0)
    };
    let parts: [f64; PARTS] = std::array::from_fn(median);
    if parts.is_sorted() && parts[PARTS - 1] > FACTOR * parts[0] && parts[PARTS - 1] > 1e-5 {
        let text = format!(
            "a step takes {:.1e} s in the last quarter of the run, but {:.1e} s in the first: steps take longer and longer",
            parts[PARTS - 1],
            parts[0]
        );
        subject.report.find(&STEADY_TIME, text);
    }
}

/// Constants and fixed parameters.
fn constants<'a>(subject: &'a Subject<'_>) -> impl Iterator<Item = &'a ScalarVariable<'a>> {
    subject.all().filter(|v| {
        let fixed = matches!(v.variability, Variability::Constant | Variability::Fixed);
        fixed && v.causality != Causality::Independent
    })
}

/// The values that the XML allows for an Integer or an Enumeration.
enum Allowed {
    Range(RangeInclusive<i64>),
    Items(HashSet<i64>),
}

impl Allowed {
    fn of(variable: &ScalarVariable<'_>) -> Self {
        match variable.kind {
            VariableType::Enumeration => Self::Items(numbers(variable).collect()),
            _ => Self::Range(integer_range(variable)),
        }
    }

    fn contain(&self, value: &i64) -> bool {
        match self {
            Self::Range(range) => range.contains(value),
            Self::Items(items) => items.is_empty() || items.contains(value),
        }
    }
}

/// Looks for invalid values in a run.
struct Watch<'a> {
    reals: Vec<(&'a ScalarVariable<'a>, f64, f64)>,
    integers: Vec<(&'a ScalarVariable<'a>, Allowed)>,
    booleans: Vec<&'a ScalarVariable<'a>>,
    strings: Vec<&'a ScalarVariable<'a>>,
    has_nan: bool,
    found: Vec<(&'static crate::Rule, String)>,
    seen: HashSet<&'a str>,
}

impl<'a> Watch<'a> {
    fn new(subject: &'a Subject<'_>) -> Self {
        let bound = |v: &ScalarVariable<'_>, name: &str| v.inherited(name).and_then(real);
        let reals = subject.observed.reals().iter().map(|&v| {
            let (min, max) = (bound(v, "min"), bound(v, "max"));
            (
                v,
                min.unwrap_or(f64::NEG_INFINITY),
                max.unwrap_or(f64::INFINITY),
            )
        });
        let integers = subject.observed.integers().iter();
        Self {
            reals: reals.collect(),
            integers: integers.map(|&v| (v, Allowed::of(v))).collect(),
            booleans: subject.observed.booleans().to_vec(),
            strings: subject.observed.strings().to_vec(),
            has_nan: false,
            found: vec![],
            seen: HashSet::new(),
        }
    }

    fn push(&mut self, time: f64, row: &Row) {
        for (&(variable, min, max), &value) in self.reals.iter().zip(&row.reals) {
            let slack = 1e-6 * value.abs();
            if variable.causality != Causality::Output || self.seen.contains(variable.name) {
                continue;
            }
            if !value.is_finite() {
                self.has_nan = true;
                self.seen.insert(variable.name);
                let name = quote(variable.name);
                let text = format!("{name} is {value} at t = {time} s, expected a finite number");
                self.found.push((&FINITE, text));
            } else if value < min - slack || value > max + slack {
                self.seen.insert(variable.name);
                let name = quote(variable.name);
                let text = format!(
                    "{name} is {value} at t = {time} s, expected a number from {min} to {max} as in the XML"
                );
                self.found.push((&BOUNDS, text));
            }
        }
        for ((variable, allowed), value) in self.integers.iter().zip(&row.integers) {
            if !allowed.contain(value) && self.seen.insert(variable.name) {
                let name = quote(variable.name);
                let text = format!(
                    "{name} is {value} at t = {time} s, expected a value that the XML allows"
                );
                self.found.push((&VALID_VALUES, text));
            }
        }
        for (variable, text) in self.strings.iter().zip(&row.strings) {
            if text.contains(char::REPLACEMENT_CHARACTER) && self.seen.insert(variable.name) {
                let name = quote(variable.name);
                let text = format!(
                    "{name} is {} at t = {time} s, expected text in UTF-8",
                    quote(text)
                );
                self.found.push((&VALID_VALUES, text));
            }
        }
        for (variable, value) in self.booleans.iter().zip(&row.booleans) {
            if !matches!(value, 0 | 1) && self.seen.insert(variable.name) {
                let name = quote(variable.name);
                let text = format!("{name} is {value} at t = {time} s, expected 0 or 1");
                self.found.push((&VALID_VALUES, text));
            }
        }
    }

    fn report(&self, subject: &Subject<'_>) {
        for (rule, text) in &self.found {
            subject.report.find(rule, text);
        }
    }
}

/// A short run, whose digests the parent compares with those of other processes.
pub fn trace(subject: &Subject<'_>) -> Result<()> {
    traced(subject, &subject.setup())
}

/// As [`trace`], with another name of the instance and with logging.
pub fn trace_logging(subject: &Subject<'_>) -> Result<()> {
    let setup = Setup {
        name: "another_name",
        logging: true,
        ..subject.setup()
    };
    traced(subject, &setup)
}

fn traced(subject: &Subject<'_>, setup: &Setup<'_>) -> Result<()> {
    let mut run = Run::begin(subject, setup)?;
    let mut digests = Digests::new(&subject.observed);
    let mut last = Row::default();
    for (_, row) in run.record(subject.steps)? {
        digests.push(&row);
        last = row;
    }
    for line in digests.lines(&subject.observed, &last) {
        subject.report.value(&line);
    }
    Ok(())
}

fn usual(subject: &Subject<'_>) -> Result<Trajectory> {
    Run::recorded(subject, &subject.setup())
}

fn as_new(
    subject: &Subject<'_>,
    actual: &Trajectory,
    expected: &Trajectory,
    when: &str,
) -> Result<()> {
    subject.ensure_same(
        actual,
        expected,
        subject.tolerance(),
        when,
        " as in a new instance",
    )
}

/// Runs with other parameters, resets, and runs again.
pub fn reset(subject: &Subject<'_>) -> Result<()> {
    let expected = usual(subject)?;
    let mut run = changed(subject)?;
    if subject.kind == Kind::CoSimulation {
        run.instance.terminate()?;
    }
    subject.report.stage("after fmi2Reset");
    let mut run = run.reset(subject.setup())?;
    run.initialize()?;
    let actual = run.record(subject.steps)?;
    as_new(subject, &actual, &expected, "after fmi2Reset")?;
    run.instance.terminate()?;
    Ok(())
}

/// A run that has used other parameters and inputs, if the model allows it.
fn changed<'a>(subject: &'a Subject<'a>) -> Result<Run<'a>> {
    let setup = Setup {
        seed: 2,
        ..subject.setup()
    };
    let other = Setup {
        parameters: true,
        ..setup
    };
    let run = |setup: &Setup<'a>| -> Result<Run<'a>> {
        let mut run = Run::begin(subject, setup)?;
        run.record(subject.steps)?;
        Ok(run)
    };
    run(&other).or_else(|_| run(&setup))
}

/// Changes the start values of all inputs and parameters, resets, and reads them.
pub fn reset_values(subject: &Subject<'_>) -> Result<()> {
    let settable: Vec<_> = (subject.all())
        .filter(|v| matches!(v.causality, Causality::Parameter | Causality::Input))
        .collect();
    let mut run = Run::instantiate(subject, &subject.setup())?;
    for variable in &settable {
        if let Some(value) = other(variable)
            && set(&mut run.instance, variable, &value).is_err()
        {
            return Ok(());
        }
    }
    subject.report.stage("after fmi2Reset");
    let mut run = run.reset(subject.setup())?;
    run.enter_initialization()?;
    let other_name = Setup {
        name: "other",
        ..subject.setup()
    };
    let mut new = Run::instantiate(subject, &other_name)?;
    new.enter_initialization()?;
    for variable in settable {
        let expected = read(&mut new.instance, variable)?;
        let actual = read(&mut run.instance, variable)?;
        let name = quote(variable.name);
        ensure!(
            actual == expected,
            "after fmi2Reset, {name} is {actual}, expected its start value {expected}"
        );
    }
    Ok(())
}

/// Resets a new instance, and one in initialization mode.
pub fn reset_early(subject: &Subject<'_>) -> Result<()> {
    let expected = usual(subject)?;
    for initializing in [false, true] {
        let stage = match initializing {
            false => "after fmi2Reset of a new instance",
            true => "after fmi2Reset in initialization mode",
        };
        let mut run = Run::instantiate(subject, &subject.setup())?;
        if initializing {
            run.enter_initialization()?;
        }
        subject.report.stage(stage);
        let mut run = run.reset(subject.setup())?;
        run.initialize()?;
        as_new(subject, &run.record(subject.steps)?, &expected, stage)?;
    }
    Ok(())
}

/// Runs without a stop time, and with a later one.
pub fn stop_time(subject: &Subject<'_>) -> Result<()> {
    let expected = usual(subject)?;
    let later = subject
        .stop()
        .map(|stop| stop + 9.0 * (stop - subject.start()));
    for (stop, when) in [
        (None, "without a stop time"),
        (later, "with a later stop time"),
    ] {
        let setup = Setup {
            stop,
            ..subject.setup()
        };
        subject.report.stage(when);
        let actual = Run::recorded(subject, &setup)?;
        let like = " as with the stop time of the default experiment";
        subject.ensure_same(&actual, &expected, subject.tolerance(), when, like)?;
    }
    Ok(())
}

fn has_variable_step(subject: &Subject<'_>) -> bool {
    subject.kind == Kind::CoSimulation
        && subject.claims(Capability::CanHandleVariableCommunicationStepSize)
}

/// Takes other step sizes, if the FMU declares that it can.
pub fn step_size(subject: &Subject<'_>) -> Result<()> {
    if !has_variable_step(subject) {
        return Ok(());
    }
    let mut run = Run::begin(subject, &subject.setup())?;
    run.record_in(subject.steps.min(10), &[0.5, 0.25, 0.25])
        .context("canHandleVariableCommunicationStepSize is true, but with other step sizes")?;
    Ok(())
}

/// Adds the step size to the time at each step, so that times differ from others in the last digits.
pub fn summed_times(subject: &Subject<'_>) -> Result<()> {
    let expected = usual(subject)?;
    let setup = Setup {
        summed_times: true,
        ..subject.setup()
    };
    let how = "with times that are rounded in another way";
    subject.report.stage(how);
    let actual = Run::recorded(subject, &setup)?;
    subject.ensure_same(&actual, &expected, subject.tolerance(), how, "")
}

/// Splits each step into a large and a tiny one.
pub fn micro_steps(subject: &Subject<'_>) -> Result<()> {
    /// The tiny step, as a fraction of the step size.
    const TINY: f64 = 1e-9;
    in_parts(
        subject,
        &[1.0 - TINY, TINY],
        "with each step in two parts, the second of 1e-9 of its size",
    )
}

/// Splits each step into two halves.
pub fn half_steps(subject: &Subject<'_>) -> Result<()> {
    in_parts(subject, &[0.5, 0.5], "with each step in two halves")
}

fn in_parts(subject: &Subject<'_>, fractions: &[f64], how: &str) -> Result<()> {
    /// The relative difference that is accepted.
    const TOLERANCE: f64 = 1e-3;
    if !has_variable_step(subject) {
        return Ok(());
    }
    let expected = usual(subject)?;
    subject.report.stage(how);
    let actual = Run::begin(subject, &subject.setup())?
        .record_in(subject.steps, fractions)
        .context("canHandleVariableCommunicationStepSize is true, but")?;
    let tolerance = TOLERANCE.max(subject.tolerance());
    let when = format!("canHandleVariableCommunicationStepSize is true, but {how}");
    subject.ensure_same(&actual, &expected, tolerance, &when, " as with whole steps")
}

/// Terminates, and reads the values.
pub fn end(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, &subject.setup())?;
    let rows = run.record(subject.steps)?;
    run.instance.terminate()?;
    subject.report.stage("after fmi2Terminate");
    let after = vec![(run.time(), run.observe()?)];
    let last = &rows[rows.len() - 1..];
    subject.ensure_same(
        &after,
        last,
        subject.tolerance(),
        "after fmi2Terminate",
        " as before",
    )
}

/// Runs co-simulation with event mode.
pub fn event_mode(subject: &Subject<'_>) -> Result<()> {
    if subject.kind != Kind::CoSimulation || !subject.has("hasEventMode") {
        return Ok(());
    }
    let setup = Setup {
        event_mode: true,
        ..subject.setup()
    };
    let run = || -> Result<()> {
        let mut run = Run::begin(subject, &setup)?;
        run.record(subject.steps)?;
        run.instance.terminate()?;
        Ok(())
    };
    run().context("hasEventMode is true, but")
}
