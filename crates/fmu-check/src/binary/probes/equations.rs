//! States, events and continuous-time mode, in model exchange.

use std::hint::black_box;

use anyhow::{Context, Result, ensure};
use fmu_description::{Causality, FmiVersion, Value};
use fmu_file::text::quote;
use fmu_host::Instance;

use crate::binary::observed::{is_discrete, is_near, references, shown};
use crate::binary::probes::dependencies::{WARM_UP, state_pairs};
use crate::binary::report::check;
use crate::binary::run::Run;
use crate::binary::subject::{SKIP, Subject};

/// Values that are read twice are the same, and derivatives belong to the states.
pub fn events(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    let [first, second] = [run.event_indicators()?, run.event_indicators()?];
    ensure!(
        first.iter().all(|z| z.is_finite()),
        "fmi2GetEventIndicators gave {first:?}, expected finite numbers"
    );
    ensure!(
        first == second,
        "fmi2GetEventIndicators gave {second:?} when called again, expected {first:?} as before"
    );
    if subject.states == 0 {
        return Ok(());
    }
    run.advance_by(subject.task.steps.min(WARM_UP))?;
    ensure!(!run.ended, SKIP);
    let states = run.continuous_states()?;
    let before = run.derivatives()?;
    let moved: Vec<f64> = states.iter().map(|x| x + 1e-6 * x.abs().max(1.0)).collect();
    run.instance.set_continuous_states(&moved)?;
    let read = run.continuous_states()?;
    ensure!(
        read == moved,
        "fmi2GetContinuousStates gave {read:?}, expected {moved:?} as they were set"
    );
    run.derivatives()?;
    run.instance.set_continuous_states(&states)?;
    let after = run.derivatives()?;
    ensure!(
        are_near(&before, &after),
        "fmi2GetDerivatives gave {after:?}, expected {before:?} as for the same states before"
    );
    continuous_time(subject, &mut run)
}

fn are_near(a: &[f64], b: &[f64]) -> bool {
    let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-9 * a.abs().max(1e-9) || a.is_nan();
    a.iter().zip(b).all(near)
}

/// Compares the numbers of states and event indicators with the XML, and, along a run, states and derivatives with their
/// variables.
pub fn states(subject: &Subject<'_>) -> Result<()> {
    let (n, indicators) = (subject.states, subject.indicators);
    let mut run = Run::after(subject, 1)?;
    if subject.model.version == FmiVersion::Fmi3 {
        let mut counted = [0; 2];
        run.instance.get_number_of_continuous_states(&mut counted[0])?;
        run.instance.get_number_of_event_indicators(&mut counted[1])?;
        check!(subject, "states-counted": counted == [n, indicators],
            "the binary has {} states and {} event indicators, expected {n} and {indicators}",
            counted[0], counted[1]);
    }
    check_count(&mut run, "fmi2GetContinuousStates", n, Instance::get_continuous_states)?;
    check_count(&mut run, "fmi2GetDerivatives", n, Instance::get_continuous_state_derivatives)?;
    check_count(&mut run, "fmi2GetEventIndicators", indicators, Instance::get_event_indicators)?;
    let Some((derivatives, states)) = state_pairs(subject) else { return Ok(()) };
    for (state, nominal) in states.iter().zip(run.solver.nominals.clone()) {
        let expected = state.value.real("nominal").unwrap_or(nominal);
        check!(subject, "nominals":
            run.solver.has_new_nominals || (nominal - expected).abs() <= 1e-6 * expected.abs(),
            "the nominal value of {} is {nominal}, expected {expected} as in the XML", quote(&state.name));
    }
    let (derivatives, states) = (references(&derivatives), references(&states));
    for _ in 0..subject.task.steps {
        for (function, given, expected) in [
            ("fmi2GetContinuousStates", run.continuous_states()?, run.reals(&states)?),
            ("fmi2GetDerivatives", run.derivatives()?, run.reals(&derivatives)?),
        ] {
            let time = run.time();
            ensure!(
                are_near(&given, &expected),
                "{function} gave {given:?} at t = {time} s, expected {expected:?} like the variables"
            );
        }
        run.advance()?;
        if run.ended {
            break;
        }
    }
    Ok(())
}

/// Checks that a function writes as many numbers as the XML lists.
pub fn check_count(
    run: &mut Run<'_>,
    function: &str,
    n: usize,
    get: impl FnOnce(&mut Instance, &mut [f64]) -> fmu_host::Result,
) -> Result<()> {
    const GUARD: f64 = 1.234_567_89e300;
    let mut values = vec![GUARD; n + 8];
    if n > 0 {
        get(&mut run.instance, &mut values[..n])?;
        let count = black_box(&values).iter().filter(|value| **value != GUARD).count();
        check!(run.subject, "states-counted": count == n, "{function} wrote {count} numbers, expected {n}");
    }
    Ok(())
}

/// The requirements of continuous-time mode: solvers go back in time, derivatives follow the inputs at
/// once, and discrete variables do not change.
fn continuous_time(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    let discrete = subject.group(subject.observed.variables().filter(|v| is_discrete(v)));
    let (time, step) = (run.time(), subject.step);
    let before = run.row(&discrete)?;
    let later = time + 0.1 * step;
    run.instance.set_time(later)?;
    for variable in subject.variables(Causality::Independent) {
        let read = run.value(variable).unwrap_or(Value::Float64(later));
        ensure!(
            is_near(&read, &Value::Float64(later), 1e-9 * later.abs().max(1.0)),
            "{} is {} after fmi2SetTime({later})",
            quote(&variable.name),
            shown(&read)
        );
    }
    let states = run.continuous_states()?;
    run.instance.set_continuous_states(&states)?;
    run.derivatives()?;
    let after = run.row(&discrete)?;
    let how = ["in continuous-time mode, not at an event", " as before"];
    discrete.ensure_same(&after, &before, 0.0, how)?;
    run.instance
        .set_time(time + 0.05 * step)
        .context("solvers go back in time when they reject a step, but")?;
    run.change(subject.continuous(Causality::Input).into_iter())?;
    let at_once = run.derivatives()?;
    if run.instance.completed_integrator_step()?.enter_event_mode {
        return Ok(());
    }
    let later = run.derivatives()?;
    ensure!(
        are_near(&at_once, &later),
        "fmi2GetDerivatives gave {at_once:?} after the inputs were set, expected {later:?} as after fmi2CompletedIntegratorStep"
    );
    Ok(())
}
