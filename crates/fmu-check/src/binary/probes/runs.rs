//! Runs of the default experiment, in several ways.

use std::collections::HashSet;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};
use fmu_description::{Causality, Listed, Variability};
use fmu_host::Kind;

use crate::Rule;
use crate::binary::child::Reply;
use crate::binary::inputs::{Level, allows, real_range};
use crate::binary::rules::{BOUNDS, CONSTANT, FINITE, STEADY_TIME, VALID_VALUES};
use crate::binary::run::{Run, is_refusal};
use crate::binary::subject::{Setup, Subject};
use crate::binary::values::{Row, Trajectory, Value, element_name};

/// Runs the default experiment to its end, or as far as half of the time limit allows. Reports how many
/// steps were taken and how long they took, or that the FMU refused the excitation.
pub fn experiment(subject: &Subject<'_>) -> Result<()> {
    /// Euler steps that solve stiffer models.
    const FINE: usize = 200;
    let usual = subject.setup();
    let is_still = subject.task.level == Level::Still;
    let mut watch = Watch::default();
    let mut outcome = watch.run(subject, usual);
    if watch.is_doubtful(&outcome) && subject.kind == Kind::ModelExchange && is_still {
        watch = Watch::default();
        outcome = watch.run(subject, usual.with(|s| s.parts = FINE));
    }
    if watch.is_doubtful(&outcome) && !is_still {
        // Inputs outside the model's range of validity; a weaker excitation decides.
        subject.report.reply(&Reply::Refused);
        return Ok(());
    }
    let (steps, seconds) = outcome?;
    subject.report.reply(&Reply::Ran(steps, seconds));
    for (rule, text) in watch.found {
        subject.report.find(rule, text);
    }
    Ok(())
}

/// Looks for invalid values in a run.
#[derive(Default)]
struct Watch {
    has_nan: bool,
    found: Vec<(&'static Rule, String)>,
    /// The elements about which something was found.
    seen: HashSet<usize>,
}

impl Watch {
    /// Whether the FMU has refused to go on, or computed what is not a number, which may be due to the
    /// inputs or to our solver.
    fn is_doubtful<T>(&self, outcome: &Result<T>) -> bool {
        self.has_nan || outcome.as_ref().is_err_and(is_refusal)
    }

    /// Runs to the end; returns the number of steps and their duration.
    fn run(&mut self, subject: &Subject<'_>, setup: Setup<'_>) -> Result<(usize, f64)> {
        let begin = Instant::now();
        let mut run = Run::begin(subject, setup)?;
        let constants: Vec<_> = constants(subject).collect();
        let values = |run: &mut Run<'_>| -> Result<Vec<Value>> {
            constants.iter().map(|v| run.value(v)).collect()
        };
        let before = values(&mut run)?;
        let elements: Vec<_> = subject.observed.elements().collect();
        let mut times = Vec::new();
        let limit = Duration::from_secs(subject.task.seconds) / 2;
        let steps = run.run_for(limit, |time, row| {
            times.push(Instant::now());
            self.push(&elements, time, row);
        })?;
        if let Some(text) = slows_down(steps, &times) {
            subject.report.find(&STEADY_TIME, text);
        }
        if !run.ended {
            for ((variable, before), after) in constants.iter().zip(before).zip(values(&mut run)?) {
                if !after.is_near(&before, 0.0) {
                    let name = element_name(variable, 0);
                    let text = format!(
                        "{name} is {after} at the end of the run, expected {before} as after initialization"
                    );
                    self.found.push((&CONSTANT, text));
                }
            }
        }
        run.instance.terminate()?;
        Ok((steps, begin.elapsed().as_secs_f64()))
    }

    fn push(&mut self, elements: &[(&Listed<'_>, usize)], time: f64, row: &Row) {
        for (at, (value, (variable, element))) in row.iter().zip(elements).enumerate() {
            let Some((rule, expected)) = fault(variable, value) else {
                continue;
            };
            self.has_nan |= *rule == FINITE;
            if self.seen.insert(at) {
                let name = element_name(variable, *element);
                let text = format!("{name} is {value} at t = {time} s, expected {expected}");
                self.found.push((rule, text));
            }
        }
    }
}

/// Constants and fixed parameters.
fn constants<'a>(subject: &Subject<'a>) -> impl Iterator<Item = &'a Listed<'a>> {
    subject.all().filter(|v| {
        let fixed = matches!(v.variability, Variability::Constant | Variability::Fixed);
        fixed && v.causality != Causality::Independent
    })
}

/// The rule that a value in a run breaks, and what was expected.
fn fault(variable: &Listed<'_>, value: &Value) -> Option<(&'static Rule, String)> {
    match value {
        Value::Real(_) if variable.causality != Causality::Output => None,
        Value::Real(value) if !value.is_finite() => Some((&FINITE, "a finite number".into())),
        Value::Real(value) => {
            let (min, max) = real_range(variable);
            let slack = 1e-6 * value.abs();
            let text = || format!("a number from {min} to {max} as in the XML");
            (*value < min - slack || *value > max + slack).then(|| (&BOUNDS, text()))
        }
        Value::Boolean(0 | 1) => None,
        Value::Boolean(_) => Some((&VALID_VALUES, "0 or 1".into())),
        Value::Text(text) => text
            .contains(char::REPLACEMENT_CHARACTER)
            .then(|| (&VALID_VALUES, "text in UTF-8".into())),
        whole => (!allows(variable, whole))
            .then(|| (&VALID_VALUES, "a value that the XML allows".into())),
    }
}

/// Compares the durations of the parts of a run; says so if steps take longer and longer.
fn slows_down(steps: usize, times: &[Instant]) -> Option<String> {
    const PARTS: usize = 4;
    /// How much longer the last part must take than the first.
    const FACTOR: f64 = 4.0;
    if steps < 20 * PARTS {
        return None;
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
    let [first, .., last] = parts;
    (parts.is_sorted() && last > FACTOR * first && last > 1e-5).then(|| {
        format!(
            "a step takes {last:.1e} s in the last quarter of the run, but {first:.1e} s in the first: steps take longer and longer"
        )
    })
}

/// A short run, which the parent compares with those of other processes.
pub fn trace(subject: &Subject<'_>) -> Result<()> {
    traced(subject, subject.setup())
}

/// As [`trace`], with another name of the instance and with logging.
pub fn trace_logging(subject: &Subject<'_>) -> Result<()> {
    let setup = subject.setup();
    traced(
        subject,
        setup.with(|s| (s.name, s.logging) = ("another_name", true)),
    )
}

fn traced(subject: &Subject<'_>, setup: Setup<'_>) -> Result<()> {
    for (time, row) in Run::recorded(subject, setup)? {
        subject.report.reply(&Reply::Row(time, row));
    }
    Ok(())
}

/// Runs next to a second instance with other inputs and parameters.
pub fn beside(subject: &Subject<'_>, how: &str) -> Result<Trajectory> {
    subject.report.stage(how);
    let changed = subject.other().with(|s| s.parameters = true);
    let mut one = Run::begin(subject, subject.setup())?;
    let mut two = Run::begin(subject, changed).or_else(|_| Run::begin(subject, subject.other()))?;
    one.record_by(|one| {
        two.advance()?;
        one.advance()?;
        one.ended |= two.ended;
        Ok(())
    })
}

/// Runs a new instance after another one was freed.
pub fn after_another(subject: &Subject<'_>, how: &str) -> Result<Trajectory> {
    Run::recorded(subject, subject.other())?;
    subject.report.stage(how);
    Run::recorded(subject, subject.setup())
}

/// Runs on a thread that has not created the instance.
pub fn on_a_thread(subject: &Subject<'_>, how: &str) -> Result<Trajectory> {
    let mut run = Run::begin(subject, subject.setup())?;
    subject.report.stage(how);
    let rows = thread::scope(|scope| scope.spawn(|| run.record()).join());
    rows.map_err(|_| anyhow!("the thread has ended early"))?
}

/// Runs two instances on two threads at the same time, again and again for a while.
pub fn on_threads(subject: &Subject<'_>) -> Result<()> {
    const DURATION: Duration = Duration::from_millis(500);
    const HOW: &str = "with another instance on another thread";
    let setups = [subject.setup(), subject.other()];
    let expected = [
        Run::recorded(subject, setups[0])?,
        Run::recorded(subject, setups[1])?,
    ];
    subject.report.stage(HOW);
    let begin = Instant::now();
    while begin.elapsed() < DURATION {
        let actual = thread::scope(|scope| {
            let threads = setups.map(|setup| scope.spawn(move || Run::recorded(subject, setup)));
            threads.map(|thread| thread.join())
        });
        for (actual, expected) in actual.into_iter().zip(&expected) {
            let actual = actual.map_err(|_| anyhow!("a thread has ended early"))??;
            subject.ensure_same(&actual, expected, 1e-9, HOW, " as alone")?;
        }
    }
    Ok(())
}

/// Runs with other parameters and inputs, if the model allows it, resets, and runs again.
pub fn reset(subject: &Subject<'_>, how: &str) -> Result<Trajectory> {
    let inputs = subject.setup().with(|s| s.seed = 2);
    let all = inputs.with(|s| s.parameters = true);
    let run = |setup| -> Result<Run<'_>> {
        let mut run = Run::begin(subject, setup)?;
        run.record()?;
        Ok(run)
    };
    let mut run = run(all).or_else(|_| run(inputs))?;
    if subject.kind == Kind::CoSimulation {
        run.instance.terminate()?;
    }
    let mut run = reset_and_run(subject, run, how)?;
    let rows = run.record()?;
    run.instance.terminate()?;
    Ok(rows)
}

/// Resets a new instance.
pub fn reset_new(subject: &Subject<'_>, how: &str) -> Result<Trajectory> {
    let run = Run::instantiate(subject, subject.setup())?;
    reset_and_run(subject, run, how)?.record()
}

/// Resets an instance in initialization mode.
pub fn reset_initializing(subject: &Subject<'_>, how: &str) -> Result<Trajectory> {
    let run = Run::initializing(subject, subject.setup())?;
    reset_and_run(subject, run, how)?.record()
}

fn reset_and_run<'a>(subject: &Subject<'_>, run: Run<'a>, how: &str) -> Result<Run<'a>> {
    subject.report.stage(how);
    let mut run = run.reset()?;
    run.initialize()?;
    Ok(run)
}

/// Takes other step sizes, if the FMU declares that it can.
pub fn step_sizes(subject: &Subject<'_>) -> Result<()> {
    subject.report.stage("with other step sizes");
    let setup = subject.setup().with(|s| s.fractions = &[0.5, 0.25, 0.25]);
    let mut run = Run::begin(subject, setup)?;
    run.advance_by(subject.task.steps.min(10))
}

/// Terminates, and reads the values.
pub fn end(subject: &Subject<'_>) -> Result<()> {
    const HOW: &str = "after fmi2Terminate";
    let mut run = Run::begin(subject, subject.setup())?;
    let rows = run.record()?;
    run.instance.terminate()?;
    subject.report.stage(HOW);
    let after = vec![(run.time(), run.observe()?)];
    let last = &rows[rows.len() - 1..];
    subject.ensure_same(&after, last, subject.tolerance(), HOW, " as before")
}

/// Runs co-simulation with event mode.
pub fn event_mode(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup().with(|s| s.event_mode = true))?;
    run.record()?;
    run.instance.terminate()?;
    Ok(())
}
