//! Runs of the default experiment in several ways, and instances that are reset, saved and restored.

use std::collections::HashSet;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, ensure};
use fmu_description::{Causality, Type, Value, Variability, XmlVariable};
use fmu_file::text::quote;
use fmu_host::InterfaceType;

use crate::binary::excitation::{allows, real_range};
use crate::binary::observed::{Row, Trajectory, element_name, shown};
use crate::binary::report::check;
use crate::binary::run::{Run, is_refusal};
use crate::binary::subject::{RunSetup, SKIP, Subject};
use crate::binary::task::{Pace, Reply};
use crate::rule::{Rule, rule};

/// Maximum size of a serialized state.
const MAX_BYTES: usize = 1 << 30;

/// The error of a solver that starts anew.
pub const RESTART: f64 = 1e-3;

/// The findings of a run.
type Found = Vec<(&'static Rule, String)>;

/// Runs the default experiment to its end, or as far as half of the time limit allows. Reports how many
/// steps were taken and how long they took, unless the FMU refused the excitation.
pub fn experiment(subject: &Subject<'_>) -> Result<()> {
    /// Parts of a step in which the solver, which begins with short steps, does not try states that are far off.
    const FINE: usize = 200;
    let setup = subject.setup();
    let is_still = setup.excitation == 0.0;
    // The FMU has refused to go on, or computed what is not a number, which may be due to the inputs or to
    // our solver.
    let is_doubtful = |outcome: &Result<_>, found: &Found| {
        let is_doubt = |(rule, _): &(&'static Rule, String)| {
            [rule!("finite-outputs"), rule!("not-tested")].contains(rule)
        };
        found.iter().any(is_doubt) || outcome.as_ref().is_err_and(is_refusal)
    };
    let (mut outcome, mut found) = watch(subject, setup);
    if is_doubtful(&outcome, &found)
        && subject.interface_type == InterfaceType::ModelExchange
        && is_still
    {
        (outcome, found) = watch(subject, setup.with(|s| s.parts = FINE));
    }
    if is_doubtful(&outcome, &found) && !is_still {
        // Inputs outside the model's range of validity; a weaker excitation decides.
        return Ok(());
    }
    let pace = outcome?;
    subject.report.reply(&Reply::Ran(pace));
    for (rule, text) in found {
        subject.report.add_finding(rule, text);
    }
    Ok(())
}

/// Runs to the end and looks for invalid values; returns how fast it was, and what was found.
fn watch(subject: &Subject<'_>, setup: RunSetup<'_>) -> (Result<Pace>, Found) {
    /// Larger states are likely to be an error of our solver.
    const MODERATE: f64 = 1e6;
    let elements: Vec<_> = subject.observed.elements().collect();
    let constants = subject.readable().filter(|v| {
        use Variability::{Constant, Fixed, Tunable};
        // No tunable parameter is set in this run.
        let is_fixed = matches!(v.variability, Constant | Fixed | Tunable);
        is_fixed && v.causality != Causality::Independent
    });
    let constants = subject.group(constants);
    let (mut found, mut seen, mut times) = (Found::new(), HashSet::new(), Vec::new());
    let limit = Duration::from_secs(subject.task.seconds) / 2;
    let begin = Instant::now();
    let mut run_all = || {
        let mut run = Run::begin(subject, setup)?;
        let before = run.row(&constants)?;
        let steps = run.run_for(limit, |time, row| {
            times.push(Instant::now());
            for (at, (value, (variable, element))) in row.iter().zip(&elements).enumerate() {
                // Of each element, the first that is found by a rule.
                if let Some((rule, expected)) = fault(variable, value)
                    && seen.insert((at, rule.id))
                {
                    let (name, value) = (element_name(variable, *element), shown(value));
                    let text = format!("{name} is {value} at t = {time} s, expected {expected}");
                    found.push((rule, text));
                }
            }
        })?;
        if let Some(text) = slows_down(steps, &times) {
            subject.report.add_finding(rule!("steady-time"), text);
        }
        if run.stuck.is_some()
            && let (Ok(states), Ok(rates)) = (run.continuous_states(), run.derivatives())
            && states.iter().all(|state| state.abs() < MODERATE)
            && rates.iter().any(|rate| rate.is_nan())
        {
            let text = format!("fmi2GetDerivatives gave {rates:?} for the states {states:?}");
            found.push((rule!("finite-outputs"), format!("{text}, expected finite numbers")));
        } else if let Some(reason) = &run.stuck {
            let text = format!("not tested: the rest of the default experiment, as {reason}");
            found.push((rule!("not-tested"), text));
        }
        if !run.ended {
            let after = run.row(&constants)?;
            let how = ["at the end of the run", " as after initialization"];
            let changed = constants.differences(&after, &before, 0.0, how);
            found.extend(changed.into_iter().map(|changed| (rule!("constants"), changed.text)));
        }
        if run.stuck.is_none() && !subject.task.is_quick {
            for text in run.unseen() {
                subject.report.reply(&Reply::Hint(text));
            }
        }
        run.instance.terminate()?;
        let between = times.windows(2).map(|pair| pair[1] - pair[0]);
        let beginning = times.first().map(|first| *first - begin);
        let longest = between.chain(beginning).max().unwrap_or_default().as_secs_f64();
        Ok(Pace { steps, seconds: begin.elapsed().as_secs_f64(), longest })
    };
    (run_all(), found)
}

/// The rule that a value in a run breaks, and what was expected.
fn fault(variable: &XmlVariable<'_>, value: &Value) -> Option<(&'static Rule, String)> {
    let invalid = |expected: &str| Some((rule!("valid-values"), expected.to_owned()));
    match (value, value.as_real()) {
        (Value::String(text), _) if text.contains(char::REPLACEMENT_CHARACTER) => {
            invalid("text in UTF-8")
        }
        // The sizes of Binaries are checked when they are read.
        (Value::String(_) | Value::Boolean(_) | Value::Binary(_), _) => None,
        _ if variable.of_type == Type::Boolean => invalid("0 or 1"),
        (_, Some(_)) if variable.causality != Causality::Output => None,
        (_, Some(number)) if !number.is_finite() => {
            Some((rule!("finite-outputs"), "a finite number".into()))
        }
        (_, Some(number)) => {
            let (min, max) = real_range(variable);
            let slack = 1e-6 * number.abs();
            let is_within = min - slack <= number && number <= max + slack;
            let text = || format!("a number from {min} to {max} as in the XML");
            (!is_within).then(|| (rule!("bounds"), text()))
        }
        _ if allows(variable, value) => None,
        _ => invalid("a value that the XML allows"),
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

/// A short run, which the parent compares with runs of other processes.
pub fn trace(subject: &Subject<'_>, setup: RunSetup<'_>) -> Result<()> {
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

/// Takes each step on a new thread, and reads the values on one that has not created the instance.
pub fn on_a_thread(subject: &Subject<'_>, how: &str) -> Result<Trajectory> {
    let mut run = Run::begin(subject, subject.setup())?;
    subject.report.stage(how);
    on_new_thread(|| run.record_by(|run| on_new_thread(|| run.advance())))
}

fn on_new_thread<T: Send>(work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    let done = thread::scope(|scope| scope.spawn(work).join());
    done.map_err(|_| anyhow!("the thread has ended early"))?
}

/// Runs two instances on two threads at the same time, again and again for a while.
pub fn on_threads(subject: &Subject<'_>) -> Result<()> {
    const DURATION: Duration = Duration::from_millis(500);
    const HOW: &str = "with another instance on another thread";
    let setups = [subject.setup(), subject.other()];
    let alone = setups.map(|setup| Run::recorded(subject, setup));
    let expected = alone.into_iter().collect::<Result<Vec<_>>>()?;
    subject.report.stage(HOW);
    let begin = Instant::now();
    while begin.elapsed() < DURATION {
        let actual = thread::scope(|scope| {
            let threads = setups.map(|setup| scope.spawn(move || Run::recorded(subject, setup)));
            threads.map(|thread| thread.join())
        });
        for (actual, expected) in actual.into_iter().zip(&expected) {
            let actual = actual.map_err(|_| anyhow!("a thread has ended early"))??;
            (subject.observed).ensure_same(&actual, expected, 1e-9, [HOW, " as alone"])?;
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
    if subject.interface_type == InterfaceType::CoSimulation {
        run.instance.terminate()?;
    }
    reset_and_run(subject, how, run)
}

/// Resets an instance and runs.
pub fn reset_and_run(subject: &Subject<'_>, how: &str, run: Run<'_>) -> Result<Trajectory> {
    subject.report.stage(how);
    let mut run = run.reset()?;
    run.initialize()?;
    let rows = run.record()?;
    run.instance.terminate()?;
    Ok(rows)
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
    ensure!(!run.ended, SKIP);
    run.instance.terminate()?;
    subject.report.stage(HOW);
    let after = run.row(&subject.observed)?;
    let last = &rows[rows.len() - 1..];
    (subject.observed).ensure_same(&after, last, subject.tolerance, [HOW, " as before"])
}

/// Runs with event mode.
pub fn event_mode(subject: &Subject<'_>) -> Result<()> {
    run_with(subject, |s| s.event_mode = true)?;
    if !subject.claims("canHandleVariableCommunicationStepSize") {
        return Ok(());
    }
    // Steps across events, from which the FMU must not return early.
    const SIZE: f64 = 2.5;
    let steps = (subject.all_steps() as f64 / SIZE) as usize;
    let mut run = Run::begin(subject, subject.still().with(|s| s.event_mode = true))?;
    for k in 0..steps.min(20) {
        let (begin, size) = (k as f64 * SIZE * subject.step, SIZE * subject.step);
        match run.step(subject.start + begin, size) {
            Err(error) if is_refusal(&error) => break,
            outcome => outcome?,
        }
    }
    Ok(())
}

/// Runs with all that the FMU may do in a step: with event mode, if it has that, with early return, and with
/// intermediate updates.
pub fn flags(subject: &Subject<'_>) -> Result<()> {
    const PROVIDES: &str = "providesIntermediateUpdate";
    let event_mode = subject.claims("hasEventMode");
    subject.report.stage("with early return and intermediate updates");
    run_with(subject, |s| (s.event_mode, s.early_return) = (event_mode, true))?;
    let updates = subject.updates.load(Relaxed);
    check!(subject, "intermediate-update-flag": updates == 0 || subject.claims(PROVIDES),
        "{PROVIDES} is false; calls of the callback: {updates}, expected none");
    Ok(())
}

fn run_with(subject: &Subject<'_>, change: impl FnOnce(&mut RunSetup<'_>)) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup().with(change))?;
    run.record()?;
    run.instance.terminate()?;
    Ok(())
}

/// Runs from the middle of the default experiment, for which its tables have rows. The FMU may refuse to begin there.
pub fn start_time(subject: &Subject<'_>) -> Result<()> {
    const STEPS: usize = 20;
    // The solver of an FMU may end its steps elsewhere than at communication points, which another instance shows.
    let is_exact = !subject.is_alone()
        && follow_time(subject, Run::begin(subject, subject.still())?, STEPS).is_ok();
    let mut moved = subject.again()?;
    let later = (subject.all_steps() / 2).max(1) as f64 * subject.step;
    (moved.start, moved.span) = (subject.start + later, subject.span - later);
    let run = Run::begin(&moved, moved.still()).ok().context(SKIP)?;
    moved.report.stage(format!("from t = {} s on", moved.start));
    match follow_time(&moved, run, if is_exact { STEPS } else { 0 }) {
        Err(error) if is_refusal(&error) => {
            subject.report.fail(rule!("start-time-steps"), &format!("{error:#}"));
            Ok(())
        }
        outcome => outcome,
    }
}

/// Compares the independent variable with the time, at the start and after each of a few steps.
fn follow_time(subject: &Subject<'_>, mut run: Run<'_>, steps: usize) -> Result<()> {
    let time = subject.group(subject.variables(Causality::Independent));
    for step in 0..=steps.min(subject.task.steps) {
        if step > 0 {
            run.advance()?;
        }
        if run.ended {
            break;
        }
        let now = run.time();
        let expected = [(now, time.variables().map(|_| Value::Float64(now)).collect())];
        let how = ["in a run that starts at another time", ""];
        time.ensure_same(&run.row(&time)?, &expected, 1e-9, how)?;
    }
    Ok(())
}

/// Changes each tunable parameter before the run and in it, and compares the outputs with the outputs of a run without
/// changes.
pub fn tunable_effect(subject: &Subject<'_>) -> Result<()> {
    let tunable = |v: &&XmlVariable<'_>| v.variability == Variability::Tunable;
    let later = subject.task.steps / 4;
    let outputs = subject.group(subject.variables(Causality::Output));
    let last = |change: Option<(&XmlVariable<'_>, usize)>| -> Result<Trajectory> {
        let mut run = Run::instantiate(subject, subject.setup())?;
        let mut rows = Trajectory::new();
        for step in 0..subject.task.steps {
            if let Some((variable, at)) = change
                && at == step
            {
                run.at_event(|run| run.change([variable].into_iter()))?;
            }
            if step == 0 {
                run.initialize()?;
            }
            run.advance()?;
            if step > later {
                rows.extend(run.row(&outputs)?);
            }
        }
        Ok(rows)
    };
    let usual = last(None)?;
    let has_effect =
        |changed: &[(f64, Row)]| outputs.ensure_same(changed, &usual, 1e-6, [""; 2]).is_err();
    const MAX_PARAMETERS: usize = 20;
    for parameter in subject.variables(Causality::Parameter).filter(tunable).take(MAX_PARAMETERS) {
        // Values outside the model's range of validity are none of this test's business.
        let (Ok(before), Ok(during)) = (last(Some((parameter, 0))), last(Some((parameter, later))))
        else {
            continue;
        };
        check!(subject, "tunable-effect": has_effect(&during) || !has_effect(&before),
            "{} changes the outputs if it is set before initialization, but not between two steps",
            quote(&parameter.name));
    }
    Ok(())
}

/// Saves a state, runs on with other parameters, restores it, and runs the same again.
pub fn restore(subject: &Subject<'_>) -> Result<()> {
    let tolerance = subject.tolerance;
    let mut run = Run::begin(subject, subject.setup())?;
    let past = run.record()?;
    let position = run.position.clone();
    let saved = run.instance.get_fmu_state()?;
    let set = subject.group(subject.settable());
    let set_before = run.row(&set)?;
    let future = run.record()?;
    // Errors of a solver are relative to the values in the whole run.
    let expected = [&future[..], &past[..]].concat();
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
        run.position = position.clone();
        let when = "after the state was restored";
        subject.report.stage(when);
        let how = [when, " as when it was saved"];
        (subject.observed).ensure_same(&run.row(&subject.observed)?, &expected, tolerance, how)?;
        set.ensure_same(&run.row(&set)?, &set_before, tolerance, how)?;
        let actual = run.record()?;
        let when = "after steps from the restored state";
        let tolerance = tolerance.max(RESTART);
        (subject.observed).ensure_same(&actual, &expected, tolerance, [when, " as before"])?;
    }
    run.instance.free_fmu_state(saved)?;
    Ok(())
}

/// Changes tunable parameters and Strings, which belong to the state.
fn tune(subject: &Subject<'_>, run: &mut Run<'_>) {
    let belongs = subject.settable().filter(|v| match v.causality {
        Causality::Parameter => v.variability == Variability::Tunable,
        // Other inputs change in the run.
        _ => v.of_type == Type::String,
    });
    let _ = run.at_event(|run| run.change(belongs));
}

/// Restores a state from bytes, in another instance, which has other parameters if the model allows it.
pub fn serialize(subject: &Subject<'_>) -> Result<()> {
    let saved = |setup| -> Result<_> {
        let mut run = Run::begin(subject, setup)?;
        let past = run.record()?;
        let position = run.position.clone();
        let bytes = bytes(&mut run)?;
        let expected = [run.record()?, past].concat();
        Ok((run, position, bytes, expected))
    };
    let changed = saved(subject.setup().with(|s| s.parameters = !subject.is_alone()));
    let (run, position, bytes, expected) = changed.or_else(|_| saved(subject.setup()))?;
    if run.ended {
        return Ok(());
    }
    let mut other = run;
    if !subject.is_alone() {
        subject.report.stage("in another instance");
        other = Run::begin(subject, subject.other().with(|s| s.seed = 2))?;
        other.advance_by(3)?;
        other.observe()?;
        other.setup = subject.setup();
    }
    let state = other.instance.deserialize_fmu_state(&bytes)?;
    other.instance.set_fmu_state(&state)?;
    other.instance.free_fmu_state(state)?;
    other.position = position;
    let actual = other.record()?;
    let how = ["after steps from the state restored from bytes", " as in the first instance"];
    (subject.observed).ensure_same(&actual, &expected, subject.tolerance.max(RESTART), how)
}

/// A serialized state.
pub fn bytes(run: &mut Run<'_>) -> Result<Vec<u8>> {
    let state = run.instance.get_fmu_state()?;
    let bytes = run.instance.serialize_fmu_state(&state, MAX_BYTES)?;
    run.instance.free_fmu_state(state)?;
    Ok(bytes)
}

/// Changes the start values of all inputs and parameters, resets, and reads them.
pub fn reset_values(subject: &Subject<'_>) -> Result<()> {
    let changed = |arrays: bool| -> Result<Run<'_>> {
        let mut run = Run::instantiate(subject, subject.setup())?;
        run.change(subject.settable().filter(|v| arrays || v.dimensions.is_empty()))?;
        Ok(run)
    };
    let run = changed(true).or_else(|_| changed(false))?;
    const HOW: &str = "after fmi2Reset";
    subject.report.stage(HOW);
    let mut run = run.reset()?;
    run.enter_initialization()?;
    run.exit_initialization()?;
    let mut new = Run::initializing(subject, subject.other())?;
    new.exit_initialization()?;
    let all = subject.group(subject.settable());
    let (actual, expected) = (run.row(&all)?, new.row(&all)?);
    all.ensure_same(&actual, &expected, 0.0, [HOW, " as its start value"])
}
