//! Derivatives, dependencies and events.

use std::collections::{HashMap, HashSet};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value::{integer, unsigned};
use fmu_description::{Capability, Causality, FmiVersion, ScalarVariable, Variability};
use fmu_file::text::quote;
use fmu_host::Kind;

use crate::binary::excitation::other;
use crate::binary::record::{Class, Value, read, references};
use crate::binary::run::Run;
use crate::binary::subject::{Subject, is_real, is_tested};

/// Maximum number of inputs whose effects are tested.
const MAX_INPUTS: usize = 100;
/// Changes of an input for difference quotients, relative to its size.
const CHANGES: [f64; 2] = [1e-4, 1e-5];

/// Steps before the inputs of a run are changed.
const WARM_UP: usize = 15;

/// The effect of an input on the outputs, without a step in between.
struct Effect {
    value: f64,
    before: Vec<f64>,
}

impl Effect {
    fn new(run: &mut Run<'_>, input: &ScalarVariable<'_>, outputs: &[u32]) -> Result<Self> {
        let (mut value, mut before) = ([0.0], vec![0.0; outputs.len()]);
        run.instance.get_real(&[input.reference], &mut value)?;
        run.instance.get_real(outputs, &mut before)?;
        Ok(Self {
            value: value[0],
            before,
        })
    }

    /// The outputs after the input was changed by this much; `None` if the FMU refuses the value. The
    /// input is then changed back.
    fn of(
        &self,
        run: &mut Run<'_>,
        input: &ScalarVariable<'_>,
        outputs: &[u32],
        change: f64,
    ) -> Result<Option<Vec<f64>>> {
        let reference = [input.reference];
        if run
            .instance
            .set_real(&reference, &[self.value + change])
            .is_err()
        {
            return Ok(None);
        }
        let mut after = vec![0.0; outputs.len()];
        run.instance.get_real(outputs, &mut after)?;
        run.instance.set_real(&reference, &[self.value])?;
        Ok(Some(after))
    }

    fn size(&self) -> f64 {
        self.value.abs().max(1.0)
    }
}

/// Compares directional derivatives of outputs with difference quotients.
pub fn directional(subject: &Subject<'_>) -> Result<()> {
    if !subject.claims(Capability::ProvidesDirectionalDerivative) {
        return Ok(());
    }
    let continuous = |v: &&ScalarVariable<'_>| v.variability == Variability::Continuous;
    let of = |causality| -> Vec<_> {
        subject
            .reals(causality)
            .into_iter()
            .filter(continuous)
            .collect()
    };
    let (inputs, outputs) = (of(Causality::Input), of(Causality::Output));
    let allowed = Dependencies::of(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    // Even if no output depends on an input, the function is there.
    run.instance
        .directional_derivative(&[], &[], &[])
        .context("providesDirectionalDerivative is true, but")?;
    if run.ended || outputs.is_empty() {
        return Ok(());
    }
    for input in inputs.iter().take(MAX_INPUTS) {
        let known: Vec<_> = outputs
            .iter()
            .copied()
            .filter(|o| allowed.allow(o, input))
            .collect();
        if known.is_empty() {
            continue;
        }
        let unknowns = references(&known);
        let derivatives = run
            .instance
            .directional_derivative(&unknowns, &[input.reference], &[1.0])
            .context("providesDirectionalDerivative is true, but")?;
        let effect = Effect::new(&mut run, input, &unknowns)?;
        let mut quotients = Vec::new();
        for change in CHANGES {
            let change = change * effect.size();
            let Some(after) = effect.of(&mut run, input, &unknowns, change)? else {
                return Ok(());
            };
            let slopes = after
                .iter()
                .zip(&effect.before)
                .map(|(a, b)| (a - b) / change);
            quotients.push(slopes.collect::<Vec<f64>>());
        }
        for (i, output) in known.iter().enumerate() {
            agree(
                output,
                input,
                derivatives[i],
                quotients[0][i],
                quotients[1][i],
            )?;
        }
    }
    Ok(())
}

/// The derivatives of the states, and the states, if all are scalars that are tested.
fn state_pairs<'b, 'a>(
    subject: &'b Subject<'a>,
) -> Option<Vec<(&'b ScalarVariable<'a>, &'b ScalarVariable<'a>)>> {
    let pairs = subject.model.derivatives.iter().map(|unknown| {
        let derivative = subject.model.variable(unknown.index)?;
        let number = derivative
            .value
            .attribute("derivative")
            .and_then(unsigned)?;
        let state = match subject.model.version {
            FmiVersion::Fmi2 => subject.model.variable(number as usize)?,
            FmiVersion::Fmi3 => {
                let mut variables = subject.model.variables().map(|(_, v)| v);
                variables.find(|v| v.reference == number)?
            }
        };
        (is_real(derivative) && is_real(state) && is_tested(derivative) && is_tested(state))
            .then_some((derivative, state))
    });
    pairs.collect()
}

/// Compares adjoint derivatives with directional ones.
pub fn adjoint(subject: &Subject<'_>) -> Result<()> {
    if !subject.has("providesAdjointDerivatives") {
        return Ok(());
    }
    let mut run = Run::after(subject, WARM_UP)?;
    // Even if nothing depends on anything, the function is there.
    (run.instance.adjoint_derivatives(&[], &[], 0, &[]))
        .context("providesAdjointDerivatives is true, but")?;
    if run.ended || !subject.claims(Capability::ProvidesDirectionalDerivative) {
        return Ok(());
    }
    let allowed = Dependencies::of(subject);
    let continuous = |v: &&ScalarVariable<'_>| v.variability == Variability::Continuous;
    let inputs = subject.reals(Causality::Input).into_iter();
    let inputs: Vec<_> = inputs.filter(continuous).take(MAX_INPUTS).collect();
    let outputs = subject.reals(Causality::Output).into_iter();
    for output in outputs.filter(continuous).take(MAX_INPUTS) {
        let known = inputs.iter().copied().filter(|i| allowed.allow(output, i));
        compare_row(&mut run, output, &known.collect::<Vec<_>>())?;
    }
    if subject.kind == Kind::ModelExchange && subject.states() <= MAX_INPUTS {
        let pairs = state_pairs(subject).unwrap_or_default();
        let states: Vec<_> = pairs.iter().map(|(_, state)| *state).collect();
        for (derivative, _) in &pairs {
            compare_row(&mut run, derivative, &states)?;
        }
    }
    Ok(())
}

/// Compares the adjoint derivative of a variable with its directional derivatives.
fn compare_row(
    run: &mut Run<'_>,
    unknown: &ScalarVariable<'_>,
    knowns: &[&ScalarVariable<'_>],
) -> Result<()> {
    let of = [unknown.reference];
    let row = (run.instance)
        .adjoint_derivatives(&of, &references(knowns), knowns.len(), &[1.0])
        .context("providesAdjointDerivatives is true, but")?;
    for (known, adjoint) in knowns.iter().zip(row) {
        let column = run
            .instance
            .directional_derivative(&of, &[known.reference], &[1.0]);
        let directional = column.context("providesDirectionalDerivatives is true, but")?[0];
        let scale = adjoint.abs().max(directional.abs()).max(1e-9);
        ensure!(
            (adjoint - directional).abs() <= 1e-6 * scale,
            "the adjoint derivative of {} by {} is {adjoint}, expected {directional} like the directional derivative",
            quote(unknown.name),
            quote(known.name)
        );
    }
    Ok(())
}

/// Compares directional derivatives with respect to the states with difference quotients.
pub fn of_states(subject: &Subject<'_>) -> Result<()> {
    let n = subject.states();
    let claims = subject.claims(Capability::ProvidesDirectionalDerivative);
    if subject.kind == Kind::CoSimulation || !claims || n == 0 || n > MAX_INPUTS {
        return Ok(());
    }
    let Some(pairs) = state_pairs(subject) else {
        return Ok(());
    };
    let unknowns: Vec<u32> = pairs
        .iter()
        .map(|(derivative, _)| derivative.reference)
        .collect();
    let mut run = Run::after(subject, WARM_UP)?;
    if run.ended {
        return Ok(());
    }
    let states = run.instance.continuous_states(n)?;
    let before = run.instance.derivatives(n)?;
    for (k, (_, state)) in pairs.iter().enumerate() {
        let given = run
            .instance
            .directional_derivative(&unknowns, &[state.reference], &[1.0])
            .context("providesDirectionalDerivative is true, but")?;
        let mut quotients = Vec::new();
        for change in CHANGES {
            let mut moved = states.clone();
            let change = change * moved[k].abs().max(1.0);
            moved[k] += change;
            run.instance.set_continuous_states(&moved)?;
            let after = run.instance.derivatives(n)?;
            let slopes = after.iter().zip(&before).map(|(a, b)| (a - b) / change);
            quotients.push(slopes.collect::<Vec<f64>>());
        }
        run.instance.set_continuous_states(&states)?;
        for (i, (derivative, _)) in pairs.iter().enumerate() {
            agree(
                derivative,
                state,
                given[i],
                quotients[0][i],
                quotients[1][i],
            )?;
        }
    }
    Ok(())
}

/// Checks a directional derivative against two difference quotients, of a large and a small change.
fn agree(
    unknown: &ScalarVariable<'_>,
    known: &ScalarVariable<'_>,
    given: f64,
    coarse: f64,
    fine: f64,
) -> Result<()> {
    let (unknown, known) = (quote(unknown.name), quote(known.name));
    ensure!(
        given.is_finite(),
        "the directional derivative of {unknown} with respect to {known} is {given}, expected a finite number"
    );
    let scale = coarse.abs().max(fine.abs()).max(given.abs());
    // Where the function is not smooth, the two quotients differ.
    let smooth = (coarse - fine).abs() <= 1e-2 * scale;
    ensure!(
        !smooth || scale < 1e-6 || (given - fine).abs() <= 5e-2 * scale,
        "the directional derivative of {unknown} with respect to {known} is {given}, but {unknown} changes by {fine} per unit"
    );
    Ok(())
}

/// What the outputs depend on directly, by the XML.
struct Dependencies<'a> {
    indices: HashMap<&'a str, usize>,
    /// The inputs of each output that lists them.
    listed: HashMap<usize, HashSet<usize>>,
}

impl<'a> Dependencies<'a> {
    fn of(subject: &'a Subject<'_>) -> Self {
        let outputs = subject.model.outputs.iter().filter_map(|unknown| {
            let inputs = unknown.dependencies.as_ref()?.iter();
            Some((unknown.index, inputs.map(|index| *index as usize).collect()))
        });
        Self {
            indices: subject
                .model
                .variables()
                .map(|(index, v)| (v.name, index))
                .collect(),
            listed: outputs.collect(),
        }
    }

    fn allow(&self, output: &ScalarVariable<'_>, input: &ScalarVariable<'_>) -> bool {
        let index = |variable: &ScalarVariable<'_>| self.indices.get(variable.name);
        let listed = index(output).and_then(|output| self.listed.get(output));
        listed.is_none_or(|listed| index(input).is_none_or(|input| listed.contains(input)))
    }
}

/// Changes each input, and looks for outputs that follow though the XML says that they do not.
pub fn dependencies(subject: &Subject<'_>) -> Result<()> {
    let (inputs, outputs) = (
        subject.reals(Causality::Input),
        subject.reals(Causality::Output),
    );
    let allowed = Dependencies::of(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    if run.ended || outputs.is_empty() {
        return Ok(());
    }
    let unknowns = references(&outputs);
    for input in inputs.iter().take(MAX_INPUTS) {
        if subject.kind == Kind::ModelExchange && input.variability != Variability::Continuous {
            continue;
        }
        let effect = Effect::new(&mut run, input, &unknowns)?;
        let change = 0.1 * effect.size();
        let Some(after) = effect.of(&mut run, input, &unknowns, change)? else {
            return Ok(());
        };
        for ((output, before), after) in outputs.iter().zip(&effect.before).zip(after) {
            if *before != after && !allowed.allow(output, input) {
                bail!(
                    "{} changes from {before} to {after} with {}, which its dependencies do not list",
                    quote(output.name),
                    quote(input.name)
                );
            }
        }
    }
    Ok(())
}

/// Passes derivatives of inputs.
pub fn of_inputs(subject: &Subject<'_>) -> Result<()> {
    let inputs = references(&subject.reals(Causality::Input));
    let claims = subject.claims(Capability::CanInterpolateInputs);
    if subject.kind == Kind::ModelExchange || !claims || inputs.is_empty() {
        return Ok(());
    }
    let mut last = Vec::new();
    for derivative in [0.0, 1.0] {
        let mut run = Run::after(subject, WARM_UP)?;
        let values = vec![derivative / subject.step(); inputs.len()];
        run.instance
            .set_input_derivatives(&inputs, &values)
            .context("canInterpolateInputs is true, but")?;
        run.instance.do_step(run.time(), subject.step())?;
        last.push(vec![(run.time(), run.observe()?)]);
    }
    // An input that changes by 1 during the step must show where an input that is 1 higher does.
    let mut run = Run::after(subject, WARM_UP)?;
    let mut values = vec![0.0; inputs.len()];
    run.instance.get_real(&inputs, &mut values)?;
    values.iter_mut().for_each(|value| *value += 1.0);
    if run.instance.set_real(&inputs, &values).is_err() {
        return Ok(());
    }
    run.instance.do_step(run.time(), subject.step())?;
    let higher = vec![(run.time(), run.observe()?)];
    let differs = |a, b| {
        subject
            .observed
            .difference(a, b, subject.tolerance())
            .is_some()
    };
    ensure!(
        differs(&last[1], &last[0]) || !differs(&higher, &last[0]),
        "canInterpolateInputs is true, but derivatives of inputs have no effect"
    );
    Ok(())
}

/// Reads derivatives of outputs.
pub fn of_outputs(subject: &Subject<'_>) -> Result<()> {
    let order = subject
        .element
        .attribute("maxOutputDerivativeOrder")
        .and_then(integer);
    let outputs = references(&subject.reals(Causality::Output));
    if subject.kind == Kind::ModelExchange
        || order.is_none_or(|order| order <= 0)
        || outputs.is_empty()
    {
        return Ok(());
    }
    // With inputs that do not change.
    let mut run = Run::begin(subject, &subject.still())?;
    let (mut wrong, mut judged) = (vec![0; outputs.len()], 0);
    let mut texts = vec![String::new(); outputs.len()];
    let mut last: Option<Vec<f64>> = None;
    for _ in 0..subject.steps.min(10) {
        let values = run
            .instance
            .output_derivatives(&outputs)
            .context("maxOutputDerivativeOrder is not 0, but")?;
        ensure!(
            values.iter().all(|value| value.is_finite()),
            "maxOutputDerivativeOrder is not 0, but fmi2GetRealOutputDerivatives gave numbers that are not finite"
        );
        let mut now = vec![0.0; outputs.len()];
        run.instance.get_real(&outputs, &mut now)?;
        if let Some(last) = last {
            judged += 1;
            for (i, (now, last)) in now.iter().zip(last).enumerate() {
                let slope = (now - last) / subject.step();
                let scale = slope.abs().max(values[i].abs());
                if (slope - values[i]).abs() > 0.8 * scale && scale > 1e-6 {
                    wrong[i] += 1;
                    texts[i] = format!(
                        "{} while the output changes by {slope} per second",
                        values[i]
                    );
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
    for ((count, text), output) in wrong
        .iter()
        .zip(texts)
        .zip(subject.reals(Causality::Output))
    {
        let is_continuous = output.variability == Variability::Continuous;
        ensure!(
            *count < judged || judged < 3 || !is_continuous,
            "maxOutputDerivativeOrder is not 0, but the derivative of {} is {text}",
            quote(output.name)
        );
    }
    Ok(())
}

/// In model exchange: what is read twice is the same, and derivatives belong to the states.
pub fn events(subject: &Subject<'_>) -> Result<()> {
    let n = subject.states();
    if subject.kind == Kind::CoSimulation {
        return Ok(());
    }
    let mut run = Run::after(subject, WARM_UP)?;
    if run.ended {
        return Ok(());
    }
    let indicators = subject.indicators();
    // More are refused by the run.
    if indicators > 0 {
        let first = run.instance.event_indicators(indicators)?;
        let second = run.instance.event_indicators(indicators)?;
        ensure!(
            first.iter().all(|z| z.is_finite()),
            "fmi2GetEventIndicators gave {first:?}, expected finite numbers"
        );
        ensure!(
            first == second,
            "fmi2GetEventIndicators gave {second:?} when called again, expected {first:?} as before"
        );
    }
    if n == 0 {
        return Ok(());
    }
    let states = run.instance.continuous_states(n)?;
    let before = run.instance.derivatives(n)?;
    let moved: Vec<f64> = states.iter().map(|x| x + 1e-6 * x.abs().max(1.0)).collect();
    run.instance.set_continuous_states(&moved)?;
    let read = run.instance.continuous_states(n)?;
    ensure!(
        read == moved,
        "fmi2GetContinuousStates gave {read:?}, expected {moved:?} as they were set"
    );
    run.instance.derivatives(n)?;
    run.instance.set_continuous_states(&states)?;
    let after = run.instance.derivatives(n)?;
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
    let n = subject.states();
    let discrete = |v: &&ScalarVariable<'_>| {
        v.variability == Variability::Discrete
            || Class::of(v.kind) != Class::Real && v.causality == Causality::Output
    };
    let discrete: Vec<_> = subject.observed.variables().filter(discrete).collect();
    let values = |run: &mut Run<'_>| -> Result<Vec<Value>> {
        discrete
            .iter()
            .map(|v| read(&mut run.instance, v))
            .collect()
    };
    let (time, step) = (run.time(), subject.step());
    let before = values(run)?;
    run.instance.set_time(time + 0.1 * step)?;
    let states = run.instance.continuous_states(n)?;
    run.instance.set_continuous_states(&states)?;
    run.instance.derivatives(n)?;
    for ((variable, before), after) in discrete.iter().zip(before).zip(values(run)?) {
        ensure!(
            before == after,
            "{} changed from {before} to {after} in continuous-time mode, expected it to change in events only",
            quote(variable.name)
        );
    }
    run.instance
        .set_time(time + 0.05 * step)
        .context("solvers go back in time when they reject a step, but")?;
    let continuous = |v: &&ScalarVariable<'_>| v.variability == Variability::Continuous;
    for input in subject
        .reals(Causality::Input)
        .into_iter()
        .filter(continuous)
    {
        let Some(Value::Real(value)) = other(input) else {
            continue;
        };
        if run.instance.set_real(&[input.reference], &[value]).is_err() {
            return Ok(());
        }
    }
    let at_once = run.instance.derivatives(n)?;
    if run.instance.completed_integrator_step()?.enter_event_mode {
        return Ok(());
    }
    let later = run.instance.derivatives(n)?;
    ensure!(
        are_near(&at_once, &later),
        "fmi2GetDerivatives gave {at_once:?} after the inputs were set, expected {later:?} as after fmi2CompletedIntegratorStep"
    );
    Ok(())
}
