//! Derivatives and dependencies away from where the usual run goes: late in it, and with inputs and states of other
//! signs and sizes.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use fmu_description::{Causality, Unknown, Value, XmlVariable};
use fmu_file::text::quote;
use fmu_host::InterfaceType;

use super::values::{
    Known, MAX_INPUTS, OUTPUT_DERIVATIVES, compare_all, compare_slopes, in_run, state_pairs,
};
use crate::binary::run::{Run, Subject, is_refusal};
use crate::binary::values::{real_range, references, starts, usual_change};

/// Where inputs are: their start values and these shares of their usual change; states are multiplied.
const SHARES: [f64; 3] = [-1.0, 3.0, -0.3];
/// Larger states stay where they are: few digits of the derivatives would be left.
const MODERATE: f64 = 1e3;
/// Steps before the first region.
const WARM_UP: usize = 15;

/// The value of a continuous input in a region, not at a bound.
fn elsewhere(input: &XmlVariable<'_>, share: f64) -> Option<f64> {
    let start = starts(input)?.first()?.as_real()?;
    let (min, max) = real_range(input);
    let to = start + share * usual_change(input, start);
    Some(if to <= min {
        0.5 * (start + min)
    } else if to >= max {
        0.5 * (start + max)
    } else {
        to
    })
}

/// Sets the continuous inputs of a region; returns whether the FMU accepts them.
fn set_inputs(run: &mut Run<'_>, share: f64) -> bool {
    run.subject.continuous(Causality::Input).into_iter().all(|input| {
        elsewhere(input, share).is_none_or(|to| run.set(input, &[Value::Float64(to)]).is_ok())
    })
}

/// Makes a test early and late in a run, and then in each region. What the FMU refuses there is no error.
fn visit(subject: &Subject<'_>, mut test: impl FnMut(&mut Run<'_>) -> Result<()>) -> Result<()> {
    let mut run = Run::after(subject, WARM_UP)?;
    test(&mut run)?;
    let (begin, limit) = (Instant::now(), Duration::from_secs(subject.task.seconds) / 50);
    let last = subject.all_steps().saturating_sub(SHARES.len() + 1);
    while run.place.point < last && begin.elapsed() < limit && !run.ended {
        run.advance()?;
    }
    for share in SHARES {
        let is_there = !run.ended && set_inputs(&mut run, share) && {
            let moved = match subject.interface_type {
                InterfaceType::ModelExchange => run.continuous_states().and_then(|states| {
                    if states.iter().any(|x| x.abs() > MODERATE) {
                        return Ok(());
                    }
                    let moved: Vec<f64> = states.iter().map(|x| share * x).collect();
                    run.instance.set_continuous_states(&moved).map(drop)
                }),
                // An output may follow in the next step only.
                InterfaceType::CoSimulation => {
                    let point = run.place.point;
                    run.place.point += 1;
                    run.do_step(point as f64, 1.0).map(drop)
                }
            };
            moved.is_ok()
        };
        let outputs = references(&subject.reals(Causality::Output));
        let is_finite = |values: Vec<f64>| values.iter().all(|x| x.is_finite());
        if !is_there
            || !run.reals(&outputs).is_ok_and(is_finite)
            || !run.derivatives().is_ok_and(is_finite)
        {
            break;
        }
        match test(&mut run) {
            Err(error) if is_refusal(&error) => break,
            outcome => outcome?,
        }
    }
    Ok(())
}

/// Compares directional derivatives with difference quotients.
pub fn derivatives(subject: &Subject<'_>) -> Result<()> {
    let (unknowns, knowns, allowed) = in_run(subject);
    visit(subject, |run| compare_all(run, &unknowns, &knowns, &allowed).map(drop))
}

/// Compares derivatives of outputs with their changes, with inputs that keep other values, as far as there is time.
pub fn output_derivatives(subject: &Subject<'_>, outputs: &[&XmlVariable<'_>]) -> Result<()> {
    let (begin, limit) = (Instant::now(), Duration::from_secs(subject.task.seconds) / 10);
    for share in SHARES {
        let mut run = Run::initializing(subject, subject.still())?;
        let is_there = set_inputs(&mut run, share) && run.exit_initialization().is_ok();
        let mut warms_up = || begin.elapsed() < limit && run.advance().is_ok() && !run.ended;
        if !is_there || !(0..WARM_UP).all(|_| warms_up()) {
            return Ok(());
        }
        match compare_slopes(&mut run, outputs) {
            Err(error) if is_refusal(&error) => return Ok(()),
            outcome => outcome.context(OUTPUT_DERIVATIVES)?,
        }
    }
    Ok(())
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
