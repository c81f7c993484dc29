//! The dependencies that the XML lists, compared with what follows a change.

use std::collections::{HashMap, HashSet};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, Type, Unknown, Value, XmlVariable};
use fmu_file::text::quote;
use fmu_host::InterfaceType;

use crate::binary::excitation::{other_values, starts};
use crate::binary::observed::{Observed, Row, is_near, is_tested, shown, size};
use crate::binary::probes::regions::visit;
use crate::binary::run::Run;
use crate::binary::subject::{SKIP, Subject};
use crate::rules::is_continuous;

/// Maximum number of inputs whose effects are tested.
pub const MAX_INPUTS: usize = 100;

/// Steps before the inputs of a run are changed.
pub const WARM_UP: usize = 15;

/// A known variable of a derivative, and its index if it is a state.
pub type Known<'a> = (&'a XmlVariable<'a>, Option<usize>);

/// The variables on which each variable may depend directly, by the XML.
pub struct Dependencies<'a>(HashMap<&'a str, HashSet<&'a str>>);

impl<'a> Dependencies<'a> {
    pub fn new<'b>(subject: &Subject<'a>, unknowns: impl Iterator<Item = &'b Unknown<'a>>) -> Self
    where
        'a: 'b,
    {
        let model = subject.model;
        let name = |number: &u32| Some(model.variable(model.index(*number))?.name.as_str());
        let outputs = unknowns.filter_map(|unknown| {
            let inputs = unknown.dependencies.as_ref()?.iter();
            let output = model.variable(unknown.index)?;
            Some((output.name.as_str(), inputs.filter_map(name).collect()))
        });
        Self(outputs.collect())
    }

    /// The dependencies of outputs and of derivatives of states, after initialization.
    pub fn in_run(subject: &Subject<'a>) -> Self {
        Self::new(subject, subject.model.outputs.iter().chain(&subject.model.derivatives))
    }

    pub fn allow(&self, output: &XmlVariable<'_>, input: &XmlVariable<'_>) -> bool {
        let listed = self.0.get(output.name.as_str());
        listed.is_none_or(|listed| listed.contains(input.name.as_str()))
    }
}

/// The Float64 unknowns of the initialization whose dependencies the XML lists, and what a host may set then.
pub fn initial_pairs<'a>(
    subject: &Subject<'a>,
) -> (Vec<&'a XmlVariable<'a>>, Vec<Known<'a>>, Dependencies<'a>) {
    let model = subject.model;
    let is_real = |v: &&XmlVariable<'_>| v.of_type == Type::Float64 && is_tested(v);
    let listed = model.initial_unknowns.iter().filter(|unknown| unknown.dependencies.is_some());
    let unknowns = listed.filter_map(|unknown| model.variable(unknown.index).filter(is_real));
    let knowns = subject.settable().filter(is_real).map(|v| (v, None)).take(MAX_INPUTS);
    let allowed = Dependencies::new(subject, model.initial_unknowns.iter());
    (unknowns.collect(), knowns.collect(), allowed)
}

/// The derivatives of the states, and the states, if all are scalars that are tested.
pub type Pairs<'a> = (Vec<&'a XmlVariable<'a>>, Vec<&'a XmlVariable<'a>>);

pub fn state_pairs<'a>(subject: &Subject<'a>) -> Option<Pairs<'a>> {
    let model = subject.model;
    let is_tested = |v: &&XmlVariable<'_>| v.of_type == Type::Float64 && is_tested(v);
    let pairs = model.derivatives.iter().map(|unknown| {
        let derivative = model.variable(unknown.index).filter(is_tested)?;
        let state = model.referred(derivative.value, "derivative").filter(is_tested)?;
        Some((derivative, state))
    });
    let pairs: Option<Pairs<'_>> = pairs.collect();
    pairs.filter(|(states, _)| (1..=MAX_INPUTS).contains(&states.len()))
}

/// Changes each input, and looks for outputs that follow though the XML says that they do not, at two times.
pub fn direct(subject: &Subject<'_>) -> Result<()> {
    let has_events =
        subject.interface_type == InterfaceType::ModelExchange || subject.setup().event_mode;
    let is_known =
        |v: &&XmlVariable<'_>| v.of_type != Type::String && (!has_events || is_continuous(v));
    let mut inputs: Vec<_> = subject.variables(Causality::Input).filter(is_known).collect();
    // The first that the FMU refuses to change ends the test.
    inputs.sort_by_key(|v| !v.of_type.is_float());
    let outputs = subject.group(subject.variables(Causality::Output));
    let allowed = Dependencies::in_run(subject);
    let mut run = Run::after(subject, WARM_UP)?;
    check_unlisted(&mut run, &outputs, &inputs, &allowed)?;
    run.advance_by(subject.task.steps)?;
    ensure!(!run.ended, SKIP);
    check_unlisted(&mut run, &outputs, &inputs, &allowed)
}

/// As [`direct`], in initialization mode, also with parameters.
pub fn initial(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = initial_pairs(subject);
    let knowns: Vec<_> = knowns.into_iter().map(|(known, _)| known).collect();
    let mut run = Run::initializing(subject, subject.still())?;
    subject.report.stage("in initialization mode");
    check_unlisted(&mut run, &subject.group(unknowns.into_iter()), &knowns, &allowed)
}

/// Changes each known, and checks that only unknowns that may depend on it follow. An error, such as that of an
/// assertion, is no dependency, and ends the test.
pub fn check_unlisted(
    run: &mut Run<'_>,
    unknowns: &Observed<'_>,
    knowns: &[&XmlVariable<'_>],
    allowed: &Dependencies<'_>,
) -> Result<()> {
    let knowns = &knowns[..knowns.len().min(MAX_INPUTS)];
    // All at first, as hosts must not read between set and step.
    let values = |known: &&XmlVariable<'_>| run.setting(known);
    let values: Vec<_> = knowns.iter().map(values).collect::<Result<_>>()?;
    for (known, values) in knowns.iter().zip(values) {
        let moved = values.iter().map(|value| {
            let x = value.as_real()?;
            Value::real(known.of_type, x + 0.1 * x.abs().max(1.0))
        });
        let changed = moved.collect::<Option<Vec<Value>>>().or_else(|| {
            let mut all = other_values(known).into_iter().chain(starts(known));
            all.find(|others| others.iter().zip(&values).any(|(a, b)| !is_near(a, b, 0.0)))
        });
        let Some(changed) = changed else { continue };
        let mut row = |values: &[Value]| -> Result<Row> {
            run.set(known, values).ok().context(SKIP)?;
            unknowns.read(&mut run.instance).ok().context(SKIP)
        };
        let (before, after, again) = (row(&values)?, row(&changed)?, row(&values)?);
        for ((unknown, _), ((before, after), again)) in
            unknowns.elements().zip(before.iter().zip(&after).zip(&again))
        {
            ensure!(
                is_near(before, after, noise(before, again))
                    || unknown.reference == known.reference
                    || allowed.allow(unknown, known)
                    || before.as_real().is_none() && !is_near(before, again, 0.0),
                "{} changes from {} to {} with {}, which its dependencies do not list",
                quote(&unknown.name),
                shown(before),
                shown(after),
                quote(&known.name)
            );
        }
    }
    Ok(())
}

/// How much a value may change without a cause: by rounding, by the error of an iteration, and by itself, as the time
/// that the FMU has used, which another value for the same inputs shows.
fn noise(value: &Value, again: &Value) -> f64 {
    let by_itself = match (value.as_real(), again.as_real()) {
        (Some(value), Some(again)) => (value - again).abs(),
        _ => 0.0,
    };
    (1e-8 * size(value)).max(1e-12) + 10.0 * by_itself
}

/// A dependency whose factor is the same in the whole run, by the XML.
struct Linear<'a> {
    unknown: &'a XmlVariable<'a>,
    known: Known<'a>,
    kind: &'a str,
    /// The factor where it was found first.
    factor: Option<f64>,
}

/// Compares the factors of dependencies that are said to be constant, fixed or tunable.
pub fn kinds<'a>(subject: &Subject<'a>) -> Result<()> {
    let model = subject.model;
    let mut knowns: Vec<Known<'_>> =
        subject.continuous(Causality::Input).into_iter().map(|input| (input, None)).collect();
    if subject.interface_type == InterfaceType::ModelExchange {
        let states = state_pairs(subject).unwrap_or_default().1;
        knowns.extend(states.into_iter().zip((0..).map(Some)));
    }
    let reals = subject.reals(Causality::Output);
    let derivatives = state_pairs(subject).unwrap_or_default().0;
    let is_read = |v: &XmlVariable<'_>| {
        let mut all = reals.iter().chain(&derivatives);
        all.any(|real| real.name == v.name)
    };
    let linear = |of: &Unknown<'a>| -> Option<Vec<Linear<'a>>> {
        let unknown = model.variable(of.index).filter(|v| is_read(v))?;
        let kinds = of.element.attribute("dependenciesKind")?.split_whitespace();
        let pairs = of.dependencies.as_ref()?.iter().zip(kinds);
        let pairs = pairs.filter(|(_, kind)| ["constant", "fixed", "tunable"].contains(kind));
        let pairs = pairs.filter_map(|(number, kind)| {
            let known = model.variable(model.index(*number))?;
            let known = knowns.iter().find(|(v, _)| v.name == known.name)?;
            Some(Linear { unknown, known: *known, kind, factor: None })
        });
        Some(pairs.collect())
    };
    let listed = model.outputs.iter().chain(&model.derivatives);
    let mut all: Vec<Linear<'_>> = listed.filter_map(linear).flatten().take(MAX_INPUTS).collect();
    if all.is_empty() {
        return Ok(());
    }
    visit(subject, |run| {
        let values: Vec<f64> =
            all.iter().map(|l| Ok(run.reals(&[l.known.0.reference])?[0])).collect::<Result<_>>()?;
        all.iter_mut().zip(values).try_for_each(|(linear, value)| linear.check(run, value))
    })
}

impl Linear<'_> {
    /// Compares the factor with the first one.
    fn check(&mut self, run: &mut Run<'_>, value: f64) -> Result<()> {
        /// Factors may differ this much, relative to their size, and by this part of the unknown per unit.
        const ALLOWED: f64 = 1e-3;
        const ROUNDING: f64 = 1e-9;
        let change = 1e-2 * value.abs().max(1.0);
        let [before, after] = [self.moved(run, value, 0.0)?, self.moved(run, value, change)?];
        let now = (after - before) / change;
        self.moved(run, value, 0.0)?;
        let first = *self.factor.get_or_insert(now);
        let noise = ROUNDING * before.abs().max(after.abs()).max(1.0) / change;
        if (now - first).abs() > ALLOWED * first.abs().max(now.abs()) + noise {
            let [of, by] = [self.unknown, self.known.0].map(|v| quote(&v.name));
            let kind = self.kind;
            bail!(
                "{of} changes by {first} per unit of {by} and, elsewhere, by {now}, but dependenciesKind is {kind}"
            );
        }
        Ok(())
    }

    /// The unknown when the known has another value.
    fn moved(&self, run: &mut Run<'_>, value: f64, change: f64) -> Result<f64> {
        let (known, state) = self.known;
        match state {
            None => drop(run.instance.set_float64(&[known.reference], &[value + change])?),
            Some(k) => {
                let mut states = run.continuous_states()?;
                states[k] = value + change;
                run.instance.set_continuous_states(&states)?;
            }
        }
        Ok(run.reals(&[self.unknown.reference])?[0])
    }
}
