//! Derivatives, dependencies and events.

use std::collections::{HashMap, HashSet};

use anyhow::{Context, Result, ensure};
use fmu_description::value::integer;
use fmu_description::{Causality, Listed, Type, Variability};
use fmu_file::text::quote;
use fmu_host::{Instance, Kind};

use crate::binary::run::{OrSkip, Run, Subject};
use crate::binary::values::{is_tested, other, references};

/// Maximum number of inputs whose effects are tested.
const MAX_INPUTS: usize = 100;
/// Steps before the inputs of a run are changed.
const WARM_UP: usize = 15;

/// What is allowed to depend directly on what, by the XML.
struct Dependencies<'a>(HashMap<&'a str, HashSet<&'a str>>);

impl<'a> Dependencies<'a> {
    fn of(subject: &Subject<'a>) -> Self {
        let model = subject.model;
        let name = |number: &u32| Some(model.variable(model.index(*number))?.name.as_str());
        let outputs = model.outputs.iter().filter_map(|unknown| {
            let inputs = unknown.dependencies.as_ref()?.iter();
            let output = model.variable(unknown.index)?;
            Some((output.name.as_str(), inputs.filter_map(name).collect()))
        });
        Self(outputs.collect())
    }

    fn allow(&self, output: &Listed<'_>, input: &Listed<'_>) -> bool {
        let listed = self.0.get(output.name.as_str());
        listed.is_none_or(|listed| listed.contains(input.name.as_str()))
    }
}

/// The outputs when an input is changed by this much, which is then changed back; the test ends if the FMU
/// refuses the value.
fn with_input(run: &mut Run<'_>, input: u32, change: f64, outputs: &[u32]) -> Result<Vec<f64>> {
    let value = run.reals(&[input])?[0];
    let change = change * value.abs().max(1.0);
    run.instance
        .set_float64(&[input], &[value + change])
        .or_skip()?;
    let after = run.reals(outputs)?;
    run.instance.set_float64(&[input], &[value])?;
    Ok(after)
}

/// A directional derivative of scalars with respect to one scalar.
fn directional(run: &mut Run<'_>, unknowns: &[u32], knowns: &[u32]) -> Result<Vec<f64>> {
    let seed = vec![1.0; knowns.len()];
    let get = |i: &mut Instance, values: &mut [f64]| {
        i.get_directional_derivative(unknowns, knowns, &seed, values)
    };
    Ok(run.instance.read(unknowns.len(), get)?)
}

/// Compares a directional derivative with difference quotients. `measure` returns the unknowns when the
/// known is changed by this fraction of its size, and `size` is that size.
fn compare(
    run: &mut Run<'_>,
    unknowns: &[&Listed<'_>],
    known: &Listed<'_>,
    size: f64,
    measure: impl Fn(&mut Run<'_>, f64) -> Result<Vec<f64>>,
) -> Result<()> {
    const CHANGES: [f64; 2] = [1e-4, 1e-5];
    let given = directional(run, &references(unknowns), &[known.reference])?;
    let before = measure(run, 0.0)?;
    let [coarse, fine] = [measure(run, CHANGES[0])?, measure(run, CHANGES[1])?];
    for (i, unknown) in unknowns.iter().enumerate() {
        let coarse = (coarse[i] - before[i]) / (CHANGES[0] * size);
        let fine = (fine[i] - before[i]) / (CHANGES[1] * size);
        let (given, of, by) = (given[i], quote(&unknown.name), quote(&known.name));
        ensure!(
            given.is_finite(),
            "the directional derivative of {of} with respect to {by} is {given}, expected a finite number"
        );
        let scale = coarse.abs().max(fine.abs()).max(given.abs());
        // Where the function is not smooth, the two quotients differ.
        let smooth = (coarse - fine).abs() <= 1e-2 * scale;
        ensure!(
            !smooth || scale < 1e-6 || (given - fine).abs() <= 5e-2 * scale,
            "the directional derivative of {of} with respect to {by} is {given}, but {of} changes by {fine} per unit"
        );
    }
    Ok(())
}

/// Compares directional derivatives of outputs with difference quotients.
pub fn of_outputs(subject: &Subject<'_>) -> Result<()> {
    let (inputs, outputs) = (
        subject.continuous(Causality::Input),
        subject.continuous(Causality::Output),
    );
    let allowed = Dependencies::of(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    // Even if no output depends on an input, the function is there.
    directional(&mut run, &[], &[])?;
    if run.ended || outputs.is_empty() {
        return Ok(());
    }
    for input in inputs.iter().take(MAX_INPUTS) {
        let mut known = outputs.clone();
        known.retain(|output| allowed.allow(output, input));
        let outputs = references(&known);
        if !known.is_empty() {
            let size = run.reals(&[input.reference])?[0].abs().max(1.0);
            compare(&mut run, &known, input, size, |run, change| {
                with_input(run, input.reference, change, &outputs)
            })?;
        }
    }
    Ok(())
}

/// The derivatives of the states, and the states, if all are scalars that are tested.
type Pairs<'a> = (Vec<&'a Listed<'a>>, Vec<&'a Listed<'a>>);

fn state_pairs<'a>(subject: &Subject<'a>) -> Option<Pairs<'a>> {
    let model = subject.model;
    let is_tested = |v: &&Listed<'_>| v.of_type == Type::Float64 && is_tested(v);
    let pairs = model.derivatives.iter().map(|unknown| {
        let derivative = model.variable(unknown.index).filter(is_tested)?;
        let state = model
            .referred(derivative.value, "derivative")
            .filter(is_tested)?;
        Some((derivative, state))
    });
    let pairs: Option<Pairs<'_>> = pairs.collect();
    pairs.filter(|(states, _)| (1..=MAX_INPUTS).contains(&states.len()))
}

/// Compares directional derivatives with respect to the states with difference quotients.
pub fn of_states(subject: &Subject<'_>) -> Result<()> {
    let Some((derivatives, states)) = state_pairs(subject) else {
        return Ok(());
    };
    let mut run = Run::after(subject, WARM_UP)?;
    if run.ended {
        return Ok(());
    }
    let values = run.continuous_states()?;
    for (k, state) in states.iter().enumerate() {
        let size = values[k].abs().max(1.0);
        compare(&mut run, &derivatives, state, size, |run, change| {
            let mut moved = values.clone();
            moved[k] += change * size;
            run.instance.set_continuous_states(&moved)?;
            let derivatives = run.derivatives()?;
            run.instance.set_continuous_states(&values)?;
            Ok(derivatives)
        })?;
    }
    Ok(())
}

/// Compares adjoint derivatives with directional ones.
pub fn adjoint(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::after(subject, WARM_UP)?;
    // Even if nothing depends on anything, the function is there.
    run.instance
        .get_adjoint_derivative(&[], &[], &[], &mut [])?;
    if run.ended || !subject.claims("providesDirectionalDerivative") {
        return Ok(());
    }
    let allowed = Dependencies::of(subject);
    let mut inputs = subject.continuous(Causality::Input);
    inputs.truncate(MAX_INPUTS);
    for output in subject
        .continuous(Causality::Output)
        .iter()
        .take(MAX_INPUTS)
    {
        let known = inputs.iter().copied().filter(|i| allowed.allow(output, i));
        compare_adjoint(&mut run, output, &known.collect::<Vec<_>>())?;
    }
    if let Some((derivatives, states)) = state_pairs(subject)
        && subject.kind == Kind::ModelExchange
    {
        for derivative in derivatives {
            compare_adjoint(&mut run, derivative, &states)?;
        }
    }
    Ok(())
}

/// Compares the adjoint derivative of a variable with its directional derivatives.
fn compare_adjoint(run: &mut Run<'_>, of: &Listed<'_>, knowns: &[&Listed<'_>]) -> Result<()> {
    let (unknowns, all) = ([of.reference], references(knowns));
    let get = |i: &mut Instance, values: &mut [f64]| {
        i.get_adjoint_derivative(&unknowns, &all, &[1.0], values)
    };
    let row = run.instance.read(knowns.len(), get)?;
    for (known, adjoint) in knowns.iter().zip(row) {
        let directional = directional(run, &unknowns, &[known.reference])?[0];
        let scale = adjoint.abs().max(directional.abs()).max(1e-9);
        ensure!(
            (adjoint - directional).abs() <= 1e-6 * scale,
            "the adjoint derivative of {} by {} is {adjoint}, expected {directional} like the directional derivative",
            quote(&of.name),
            quote(&known.name)
        );
    }
    Ok(())
}

/// Changes each input, and looks for outputs that follow though the XML says that they do not.
pub fn dependencies(subject: &Subject<'_>) -> Result<()> {
    let (mut inputs, outputs) = (
        subject.reals(Causality::Input),
        subject.reals(Causality::Output),
    );
    let is_exchange = subject.kind == Kind::ModelExchange;
    inputs.truncate(MAX_INPUTS);
    inputs.retain(|v| !is_exchange || v.variability == Variability::Continuous);
    let allowed = Dependencies::of(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    if run.ended || outputs.is_empty() {
        return Ok(());
    }
    let unknowns = references(&outputs);
    for input in inputs {
        let before = run.reals(&unknowns)?;
        let after = with_input(&mut run, input.reference, 0.1, &unknowns)?;
        for ((output, before), after) in outputs.iter().zip(before).zip(after) {
            ensure!(
                before == after || allowed.allow(output, input),
                "{} changes from {before} to {after} with {}, which its dependencies do not list",
                quote(&output.name),
                quote(&input.name)
            );
        }
    }
    Ok(())
}

/// Passes derivatives of inputs: an input that changes by 1 during a step must show where an input that is 1
/// higher does.
pub fn of_inputs_in_time(subject: &Subject<'_>) -> Result<()> {
    let inputs = references(&subject.reals(Causality::Input));
    if inputs.is_empty() {
        return Ok(());
    }
    let orders = vec![1; inputs.len()];
    let stepped = |change: f64, derivative: f64| -> Result<_> {
        let mut run = Run::after(subject, WARM_UP)?;
        if change == 0.0 {
            let values = vec![derivative / subject.step(); inputs.len()];
            run.instance
                .set_input_derivatives(&inputs, &orders, &values)?;
        } else {
            let values: Vec<f64> = run.reals(&inputs)?.iter().map(|u| u + change).collect();
            run.instance.set_float64(&inputs, &values).or_skip()?;
        }
        run.instance.do_step(run.time(), subject.step())?;
        Ok(vec![(run.time(), run.observe()?)])
    };
    let (still, rising) = (stepped(0.0, 0.0)?, stepped(0.0, 1.0)?);
    let higher = stepped(1.0, 0.0)?;
    let differs = |a| {
        let difference = subject.observed.difference(a, &still, subject.tolerance());
        difference.is_some()
    };
    ensure!(
        differs(&rising) || !differs(&higher),
        "canInterpolateInputs is true, but derivatives of inputs have no effect"
    );
    Ok(())
}

/// Compares derivatives of outputs with their changes, with inputs that do not change.
pub fn of_outputs_in_time(subject: &Subject<'_>) -> Result<()> {
    const CLAIM: &str = "maxOutputDerivativeOrder is not 0, but";
    let order = subject.element.attribute("maxOutputDerivativeOrder");
    let outputs = subject.reals(Causality::Output);
    let references = references(&outputs);
    if order.and_then(integer).is_none_or(|order| order <= 0) || outputs.is_empty() {
        return Ok(());
    }
    let orders = vec![1; outputs.len()];
    let mut run = Run::begin(subject, subject.still())?;
    let (mut wrong, mut judged) = (vec![0; outputs.len()], 0);
    let mut texts = vec![String::new(); outputs.len()];
    let mut last: Option<Vec<f64>> = None;
    for _ in 0..subject.task.steps.min(10) {
        let get = |i: &mut Instance, values: &mut [f64]| {
            i.get_output_derivatives(&references, &orders, values)
        };
        let given = run.instance.read(outputs.len(), get).context(CLAIM)?;
        ensure!(
            given.iter().all(|value| value.is_finite()),
            "{CLAIM} fmi2GetRealOutputDerivatives gave numbers that are not finite"
        );
        let now = run.reals(&references)?;
        if let Some(last) = last {
            judged += 1;
            for (i, (now, last)) in now.iter().zip(last).enumerate() {
                let (given, slope) = (given[i], (now - last) / subject.step());
                let scale = slope.abs().max(given.abs());
                if (slope - given).abs() > 0.8 * scale && scale > 1e-6 {
                    wrong[i] += 1;
                    texts[i] = format!("{given} while the output changes by {slope} per second");
                }
            }
        }
        last = Some(now);
        run.advance()?;
        if run.ended {
            break;
        }
    }
    // Outputs that jump have other slopes now and then.
    for ((count, text), output) in wrong.iter().zip(texts).zip(outputs) {
        let is_continuous = output.variability == Variability::Continuous;
        ensure!(
            *count < judged || judged < 3 || !is_continuous,
            "{CLAIM} the derivative of {} is {text}",
            quote(&output.name)
        );
    }
    Ok(())
}

/// What is read twice is the same, and derivatives belong to the states.
pub fn events(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::after(subject, WARM_UP)?;
    if run.ended {
        return Ok(());
    }
    let [first, second] = [run.event_indicators()?, run.event_indicators()?];
    ensure!(
        first.iter().all(|z| z.is_finite()),
        "fmi2GetEventIndicators gave {first:?}, expected finite numbers"
    );
    ensure!(
        first == second,
        "fmi2GetEventIndicators gave {second:?} when called again, expected {first:?} as before"
    );
    if subject.states() == 0 {
        return Ok(());
    }
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

/// What must hold in continuous-time mode: solvers go back in time, derivatives follow the inputs at
/// once, and discrete variables do not change.
fn continuous_time(subject: &Subject<'_>, run: &mut Run<'_>) -> Result<()> {
    let is_discrete = |v: &&Listed<'_>| {
        let is_real = v.of_type.is_float();
        v.variability == Variability::Discrete || !is_real && v.causality == Causality::Output
    };
    let discrete = subject.group(subject.observed.variables().filter(is_discrete));
    let (time, step) = (run.time(), subject.step());
    let before = run.row(&discrete)?;
    run.instance.set_time(time + 0.1 * step)?;
    let states = run.continuous_states()?;
    run.instance.set_continuous_states(&states)?;
    run.derivatives()?;
    let (after, when) = (
        run.row(&discrete)?,
        "in continuous-time mode, not at an event",
    );
    discrete.ensure_same(&after, &before, 0.0, when, " as before")?;
    run.instance
        .set_time(time + 0.05 * step)
        .context("solvers go back in time when they reject a step, but")?;
    for input in subject.continuous(Causality::Input) {
        if let Some(value) = other(input) {
            run.set(input, &[value]).or_skip()?;
        }
    }
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
