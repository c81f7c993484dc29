//! Directional and adjoint derivatives, compared with difference quotients and with each other.

use std::collections::BTreeMap;

use anyhow::{Context, Result, ensure};
use fmu_description::{Causality, Value, XmlVariable};
use fmu_file::text::quote;
use fmu_host::{Instance, InterfaceType};

use crate::binary::excitation::real_range;
use crate::binary::observed::references;
use crate::binary::probes::dependencies::{
    Dependencies, Known, MAX_INPUTS, WARM_UP, initial_pairs, state_pairs,
};
use crate::binary::probes::regions::visit;
use crate::binary::run::Run;
use crate::binary::subject::{SKIP, Subject};

/// The unknowns when a known is changed from its value by this much, which is then changed back; the test ends if the
/// FMU refuses that, which is no derivative. If the known is the state of this index, the derivatives are the first
/// unknowns.
pub fn values_after_change(
    run: &mut Run<'_>,
    (known, state, value): (&XmlVariable<'_>, Option<usize>, f64),
    change: f64,
    unknowns: &[u32],
) -> Result<Vec<f64>> {
    let Some(k) = state else {
        let known = [known.reference];
        run.instance.set_float64(&known, &[value + change]).ok().context(SKIP)?;
        let after = run.reals(unknowns).ok().context(SKIP)?;
        run.instance.set_float64(&known, &[value]).ok().context(SKIP)?;
        return Ok(after);
    };
    let states = run.continuous_states()?;
    let mut moved = states.clone();
    moved[k] += change;
    run.instance.set_continuous_states(&moved)?;
    let mut after = run.derivatives().ok().context(SKIP)?;
    after.extend(run.reals(&unknowns[states.len()..]).ok().context(SKIP)?);
    run.instance.set_continuous_states(&states)?;
    Ok(after)
}

/// A directional derivative of scalars.
fn directional(
    run: &mut Run<'_>,
    unknowns: &[u32],
    knowns: &[u32],
    seed: &[f64],
) -> Result<Vec<f64>> {
    let get = |i: &mut Instance, values: &mut [f64]| {
        i.get_directional_derivative(unknowns, knowns, seed, values)
    };
    Ok(run.instance.read(unknowns.len(), get)?)
}

/// Compares the directional derivatives of all pairs that the XML lists with difference quotients, and those for a
/// seed with several elements with their sum; returns whether there is a pair.
pub fn compare_all(
    run: &mut Run<'_>,
    unknowns: &[&XmlVariable<'_>],
    knowns: &[Known<'_>],
    allowed: &Dependencies<'_>,
) -> Result<bool> {
    let mut rows: BTreeMap<u32, Vec<(u32, f64)>> = BTreeMap::new();
    // All at first, as hosts must not read between set and step.
    let value = |(known, _): &Known<'_>| run.setting(known)?.pop().context(SKIP);
    let values: Vec<Value> = knowns.iter().map(value).collect::<Result<_>>()?;
    for (known, value) in knowns.iter().zip(values.iter().filter_map(Value::as_real)) {
        // All derivatives belong to a state.
        let is_pair = |u: &&&XmlVariable<'_>| known.1.is_some() || allowed.allow(u, known.0);
        let unknowns: Vec<_> = unknowns.iter().filter(is_pair).copied().collect();
        if !unknowns.is_empty() {
            let given = compare(run, &unknowns, *known, value)?;
            for (unknown, given) in unknowns.iter().zip(given) {
                rows.entry(unknown.reference).or_default().push((known.0.reference, given));
            }
        }
    }
    for (unknown, row) in &rows {
        let (knowns, given): (Vec<u32>, Vec<f64>) = row.iter().copied().unzip();
        let seed: Vec<f64> = (2..).map(f64::from).take(row.len()).collect();
        let terms = given.iter().zip(&seed).map(|(given, seed)| given * seed);
        let (expected, scale) = terms.fold((0.0, 1e-9), |(sum, size), x| (sum + x, size + x.abs()));
        let value = directional(run, &[*unknown], &knowns, &seed)?[0];
        ensure!(
            (value - expected).abs() <= 2.0 * NUMERICAL * scale,
            "the directional derivative of value reference {unknown} for the seed {seed:?} is {value}, expected {expected}, the sum of those for unit vectors"
        );
    }
    Ok(!rows.is_empty())
}

/// The relative error of derivatives that is allowed, since FMUs may compute them by differences, too.
const NUMERICAL: f64 = 5e-2;

/// Compares a directional derivative with difference quotients to both sides of a value, within the bounds of the XML.
fn compare(
    run: &mut Run<'_>,
    unknowns: &[&XmlVariable<'_>],
    (known, state): Known<'_>,
    value: f64,
) -> Result<Vec<f64>> {
    const CHANGES: [f64; 2] = [1e-4, 1e-5];
    /// The relative error of values with many terms.
    const ROUNDING: f64 = 1e-13;
    /// Where the function is smooth, quotients differ less, relative to the largest.
    const SMOOTH: f64 = 1e-2;
    let (all, (min, max)) = (references(unknowns), real_range(known));
    let all_given = directional(run, &all, &[known.reference], &[1.0])?;
    let mut measure = |change: f64| values_after_change(run, (known, state, value), change, &all);
    let before = measure(0.0)?;
    // For each size of the change, to both sides.
    let mut quotients = [Vec::new(), Vec::new()];
    for (size, measured) in CHANGES.iter().zip(&mut quotients) {
        for change in [*size, -size].map(|change| change * value.abs().max(1.0)) {
            if (min..=max).contains(&(value + change)) {
                measured.push((change, measure(change)?));
            }
        }
    }
    for (i, unknown) in unknowns.iter().enumerate() {
        let slope = |(change, after): &(f64, Vec<f64>)| (after[i] - before[i]) / change;
        let slopes = quotients.each_ref().map(|all| all.iter().map(slope).collect::<Vec<_>>());
        let [coarse, fine] = slopes.each_ref().map(|s| s.iter().sum::<f64>() / s.len() as f64);
        let (given, of, by) = (all_given[i], quote(&unknown.name), quote(&known.name));
        ensure!(
            given.is_finite(),
            "the directional derivative of {of} with respect to {by} is {given}, expected a finite number"
        );
        let mut both = slopes.iter().flatten();
        // In co-simulation, an output may follow an input only after the next step.
        if both.all(|slope| *slope == 0.0)
            && run.subject.interface_type == InterfaceType::CoSimulation
        {
            continue;
        }
        let scale = coarse.abs().max(fine.abs()).max(given.abs());
        // It is not at a kink, at a jump, nor where rounding prevails.
        let rounding = ROUNDING * before[i].abs() / (CHANGES[1] * value.abs().max(1.0));
        let is_smooth = (coarse - fine).abs() <= SMOOTH * scale
            && slopes[1].iter().all(|slope| (slope - fine).abs() <= SMOOTH * scale)
            && rounding <= SMOOTH * scale;
        ensure!(
            !is_smooth || scale < 1e-6 || (given - fine).abs() <= NUMERICAL * scale,
            "the directional derivative of {of} with respect to {by} is {given}, but {of} changes by {fine} per unit"
        );
    }
    Ok(all_given)
}

/// The unknowns and knowns of directional derivatives after initialization.
pub fn unknowns_and_knowns<'a>(
    subject: &Subject<'a>,
) -> (Vec<&'a XmlVariable<'a>>, Vec<Known<'a>>, Dependencies<'a>) {
    let (mut unknowns, mut states) = state_pairs(subject).unwrap_or_default();
    unknowns.extend(subject.continuous(Causality::Output));
    if subject.interface_type == InterfaceType::CoSimulation {
        states.clear();
    }
    let states = (0..).zip(states).map(|(k, state)| (state, Some(k)));
    let inputs = subject.continuous(Causality::Input).into_iter().map(|input| (input, None));
    let knowns: Vec<Known<'_>> = states.chain(inputs.take(MAX_INPUTS)).collect();
    (unknowns, knowns, Dependencies::in_run(subject))
}

/// Compares directional derivatives of outputs, and of derivatives of states, with difference quotients: at two times,
/// and in event mode.
pub fn in_run(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = unknowns_and_knowns(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    let is_called = compare_all(&mut run, &unknowns, &knowns, &allowed)?;
    run.advance_by(subject.task.steps)?;
    if is_called && !run.ended {
        compare_all(&mut run, &unknowns, &knowns, &allowed)?;
    }
    if is_called && subject.claims("hasEventMode") {
        let setup = subject.setup().with(|s| s.event_mode = true);
        let mut run = Run::begin(subject, setup)?;
        run.advance_by(subject.task.steps.min(WARM_UP))?;
        run.instance.enter_event_mode()?;
        subject.report.stage("in event mode");
        compare_all(&mut run, &unknowns, &knowns, &allowed)?;
    }
    Ok(())
}

/// Compares directional derivatives in initialization mode with difference quotients, for the pairs that the XML lists.
pub fn in_initialization(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = initial_pairs(subject);
    let mut run = Run::initializing(subject, subject.still())?;
    subject.report.stage("in initialization mode");
    compare_all(&mut run, &unknowns, &knowns, &allowed).map(drop)
}

/// Asks for directional derivatives of pairs that the XML does not list: 0, or an error.
pub fn unlisted(subject: &Subject<'_>) -> Result<()> {
    let allowed = Dependencies::in_run(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    for input in subject.continuous(Causality::Input).into_iter().take(MAX_INPUTS) {
        for output in subject.continuous(Causality::Output) {
            if allowed.allow(output, input) {
                continue;
            }
            let (of, by) = ([output.reference], [input.reference]);
            let given = directional(&mut run, &of, &by, &[1.0]).ok().context(SKIP)?[0];
            ensure!(
                given.abs() < 1e-12,
                "the directional derivative of {} with respect to {}, which its dependencies do not list, is {given}, expected 0",
                quote(&output.name),
                quote(&input.name)
            );
        }
    }
    Ok(())
}

/// Compares adjoint derivatives with directional ones.
pub fn adjoint(subject: &Subject<'_>) -> Result<()> {
    ensure!(subject.claims("providesDirectionalDerivative"), SKIP);
    let mut run = Run::after(subject, WARM_UP)?;
    let allowed = Dependencies::in_run(subject);
    let mut inputs = subject.continuous(Causality::Input);
    inputs.truncate(MAX_INPUTS);
    let outputs = subject.continuous(Causality::Output);
    for output in outputs.iter().take(MAX_INPUTS) {
        let known = inputs.iter().copied().filter(|i| allowed.allow(output, i));
        compare_adjoint(&mut run, output, &known.collect::<Vec<_>>())?;
    }
    if let Some((derivatives, states)) = state_pairs(subject)
        && subject.interface_type == InterfaceType::ModelExchange
    {
        for derivative in derivatives {
            compare_adjoint(&mut run, derivative, &states)?;
        }
    }
    Ok(())
}

/// Compares the adjoint derivative of a variable with its directional derivatives.
fn compare_adjoint(
    run: &mut Run<'_>,
    of: &XmlVariable<'_>,
    knowns: &[&XmlVariable<'_>],
) -> Result<()> {
    const SEED: f64 = 2.0;
    if knowns.is_empty() {
        return Ok(());
    }
    let (unknowns, all) = ([of.reference], references(knowns));
    let get = |i: &mut Instance, values: &mut [f64]| {
        i.get_adjoint_derivative(&unknowns, &all, &[SEED], values)
    };
    let row = run.instance.read(knowns.len(), get)?;
    for (known, adjoint) in knowns.iter().zip(row.iter().map(|adjoint| adjoint / SEED)) {
        let directional = directional(run, &unknowns, &[known.reference], &[1.0])?[0];
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

/// Compares directional derivatives with difference quotients.
pub fn elsewhere(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = unknowns_and_knowns(subject);
    visit(subject, |run| compare_all(run, &unknowns, &knowns, &allowed).map(drop))
}
