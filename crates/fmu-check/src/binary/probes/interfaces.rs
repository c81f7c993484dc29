//! Co-simulation compared with model exchange: the equations are the same, so an input that jumps has the same effect.

use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use fmu_description::{Causality, Value, Variability, XmlVariable};
use fmu_file::text::quote;
use fmu_host::Library;

use crate::binary::excitation::{other_values, real_range, starts, usual_change};
use crate::binary::observed::{Observed, Row, element_name, is_discrete, is_near, shown, size};
use crate::binary::run::Run;
use crate::binary::subject::{SKIP, Subject};
use crate::binary::task::{FMU, Task};
use crate::rule::rule;
use crate::rules::is_continuous;

/// Number of steps of a run.
const STEPS: usize = 20;
/// The communication points of the jump, and of another one that must show the same: prime numbers, since a sample at
/// the same point may see the input before or after it jumps.
const JUMPS: [usize; 2] = [3, 5];
/// Maximum number of inputs and parameters that jump.
const MAX_KNOWNS: usize = 40;
/// The relative tolerance in model exchange, far below the differences that are looked for.
const TOLERANCE: f64 = 1e-7;
/// Maximum duration of the test, as a fraction of the time limit of a call.
const SHARE: f64 = 0.1;

/// An input or tunable parameter that jumps.
struct Jump<'a> {
    variable: &'a XmlVariable<'a>,
    values: Vec<Value>,
    /// Where the same happens again.
    again: Vec<Value>,
}

/// Both interfaces of an FMU, and the variables that are compared.
struct Pair<'a> {
    co_simulation: &'a Subject<'a>,
    exchange: &'a Subject<'a>,
    compared: Observed<'a>,
    deadline: Instant,
}

/// The rows of runs at all communication points.
type Rows = Vec<Row>;

/// Lets each input and tunable parameter jump between two steps, and compares the effects in co-simulation and in model
/// exchange.
pub fn input_events(subject: &Subject<'_>) -> Result<()> {
    let Some(element) = subject.model.root.child("ModelExchange") else { return Ok(()) };
    let identifier = element.attribute("modelIdentifier").context(SKIP)?;
    let binary = Path::new(&subject.task.binary);
    let extension = binary.extension().and_then(|e| e.to_str()).context(SKIP)?;
    let other = binary.with_file_name(format!("{identifier}.{extension}"));
    let library = match other == binary {
        true => Arc::clone(subject.library),
        false => Library::load(&subject.task.session.join(FMU).join(&other), subject.model.version)
            .ok()
            .context(SKIP)?,
    };
    let task = Task { interface: "ModelExchange".to_owned(), ..subject.task.clone() };
    let exchange = Subject::new(&task, subject.model, &library, subject.report)?;
    let has_role = |v: &&XmlVariable<'_>| v.causality == Causality::Output || is_discrete(v);
    let states = (subject.model.derivatives.iter()).filter_map(|unknown| {
        let derivative = subject.model.variable(unknown.index)?;
        Some(subject.model.referred(derivative.value, "derivative")?.reference)
    });
    let states: Vec<u32> = states.collect();
    let compared = subject
        .observed
        .variables()
        .filter(|v| has_role(v) || v.of_type.is_float() && states.contains(&v.reference));
    let time = Duration::from_secs(subject.task.seconds).mul_f64(SHARE);
    let pair = Pair {
        co_simulation: subject,
        exchange: &exchange,
        compared: subject.group(compared),
        deadline: Instant::now() + time,
    };
    subject.report.stage("when an input jumps");
    pair.compare().ok().context(SKIP)?.map_or(Ok(()), |text| {
        subject.report.add_finding(rule!("input-events"), text);
        Ok(())
    })
}

impl<'a> Pair<'a> {
    /// Describes the first jump that has no effect, or not all of it, in co-simulation.
    fn compare(&self) -> Result<Option<String>> {
        let subject = self.co_simulation;
        let still = self.exchange_rows(None, true)?.0;
        let modes =
            [false, true].into_iter().filter(|mode| !mode || subject.claims("hasEventMode"));
        for event_mode in modes {
            let usual = self.co_simulation_rows(None, event_mode)?;
            let mut jumps: Vec<_> = self
                .knowns()
                .flat_map(|variable| jumps(variable).into_iter().enumerate())
                .collect();
            // The first of each variable comes first, as there may be no time for all.
            jumps.sort_by_key(|(size, _)| *size);
            for (_, jump) in jumps {
                let judge = |at, values| {
                    self.judge([&usual, &still], &jump, (at, values), event_mode).unwrap_or(None)
                };
                let found = judge(JUMPS[0], &jump.values);
                if found.is_some() && judge(JUMPS[1], &jump.again).is_some() {
                    return Ok(found);
                }
                if Instant::now() > self.deadline {
                    return Ok(None);
                }
            }
        }
        Ok(None)
    }

    /// The variables that jump: inputs, and parameters that can be set in a run.
    fn knowns(&self) -> impl Iterator<Item = &'a XmlVariable<'a>> {
        let known = |v: &&XmlVariable<'_>| {
            v.causality == Causality::Input || v.variability == Variability::Tunable
        };
        self.co_simulation.settable().filter(known).take(MAX_KNOWNS)
    }

    /// Runs in co-simulation.
    fn co_simulation_rows(
        &self,
        jump: Option<(&Jump<'a>, usize, &[Value])>,
        event_mode: bool,
    ) -> Result<Rows> {
        let subject = self.co_simulation;
        let setup = subject.still().with(|s| (s.event_mode, s.stop) = (event_mode, self.stop()));
        let mut run = Run::begin(subject, setup)?;
        let mut rows = vec![self.compared.read(&mut run.instance)?];
        for point in 0..STEPS {
            if let Some((jump, _, values)) = jump.filter(|(_, at, _)| *at == point) {
                if event_mode {
                    run.instance.enter_event_mode()?;
                }
                run.set(jump.variable, values)?;
                if event_mode {
                    run.iterate()?;
                }
            }
            let (time, step) = (subject.start + point as f64 * subject.step, subject.step);
            match event_mode {
                true => run.step(time, step)?,
                false => drop(run.instance.do_step(time, step)?),
            }
            ensure!(!run.ended && Instant::now() <= self.deadline, SKIP);
            rows.push(self.compared.read(&mut run.instance)?);
        }
        Ok(rows)
    }

    /// Runs in model exchange, where an event that a continuous input causes may go unnoticed. Returns whether there is
    /// an event, too.
    fn exchange_rows(
        &self,
        jump: Option<(&Jump<'a>, usize, &[Value])>,
        notices: bool,
    ) -> Result<(Rows, bool)> {
        let subject = self.exchange;
        let setup = subject.still().with(|s| s.stop = self.stop());
        let mut run = Run::begin(subject, setup)?;
        let mut rows = vec![self.compared.read(&mut run.instance)?];
        let mut is_event = false;
        for point in 0..STEPS {
            let (time, step) = (subject.start + point as f64 * subject.step, subject.step);
            if let Some((jump, _, values)) = jump.filter(|(_, at, _)| *at == point) {
                // A sample here may see the input before or after it jumps, and the next one is late.
                let is_due = run.position.handled >= time - 1e-6 * step;
                let is_rare = run.position.next_event.is_some_and(|next| next > time + 3.0 * step);
                ensure!(!(is_due && is_rare), SKIP);
                is_event = run.jump(jump.variable, values, notices)?;
            }
            run.integrate_part(time, step, TOLERANCE)?;
            ensure!(!run.ended && Instant::now() <= self.deadline, SKIP);
            rows.push(self.compared.read(&mut run.instance)?);
        }
        Ok((rows, is_event))
    }

    /// The stop time of the experiment, if the FMU gets one.
    fn stop(&self) -> Option<f64> {
        let subject = self.co_simulation;
        subject.stop.filter(|_| subject.all_steps() >= STEPS)
    }

    /// Describes the difference between co-simulation and model exchange after a jump, given the runs without it.
    fn judge(
        &self,
        [usual, still]: [&Rows; 2],
        jump: &Jump<'a>,
        (at, values): (usize, &[Value]),
        event_mode: bool,
    ) -> Result<Option<String>> {
        let jumps = Some((jump, at, values));
        let (right, is_event) = self.exchange_rows(jumps, true)?;
        let given = self.co_simulation_rows(jumps, event_mode)?;
        let missed = match is_event {
            true => self.exchange_rows(jumps, false).ok().map(|(rows, _)| rows),
            false => None,
        };
        let runs = Runs { usual, still, right: &right, given: &given, missed: missed.as_ref(), at };
        let elements = self.compared.elements().enumerate();
        let differs = |(element, (variable, _)): &(usize, (&XmlVariable<'_>, usize))| match variable
            .of_type
            .is_float()
            && is_continuous(variable)
        {
            true => runs.has_no_response(*element) || runs.has_missed(*element),
            false => runs.has_stayed(*element),
        };
        // A discrete variable is nearer to the cause.
        let first = elements.filter(differs).min_by_key(|(_, (v, _))| v.of_type.is_float());
        let Some((element, (variable, index))) = first else { return Ok(None) };
        let name = element_name(variable, index);
        let [right, given] = [&right, &given].map(|rows| shown(&rows[STEPS][element]));
        let time = |point: usize| self.co_simulation.start + point as f64 * self.co_simulation.step;
        let mode = if event_mode { " with event mode" } else { "" };
        Ok(Some(format!(
            "after {} has jumped to {} at t = {} s, {name} at t = {} s is {given} in co-simulation{mode}, expected {right} as in model exchange",
            quote(&jump.variable.name),
            values.first().map(shown).unwrap_or_default(),
            time(at),
            time(STEPS),
        )))
    }
}

/// Runs with a jump and without one.
struct Runs<'a> {
    /// Without a jump: in co-simulation, and in model exchange.
    usual: &'a Rows,
    still: &'a Rows,
    /// With one: in model exchange, and in co-simulation.
    right: &'a Rows,
    given: &'a Rows,
    /// In model exchange, if the event that the jump causes is not noticed.
    missed: Option<&'a Rows>,
    /// The communication point of the jump.
    at: usize,
}

impl Runs<'_> {
    /// The rows when what follows a jump at once is over: outputs may be late by some steps.
    fn settled(&self) -> RangeInclusive<usize> {
        (self.at + STEPS) / 2 + 1..=STEPS
    }

    /// Whether a discrete variable changes in model exchange, once and for all, but not in co-simulation.
    fn has_stayed(&self, element: usize) -> bool {
        let (before, after) = (&self.right[self.at][element], &self.right[STEPS][element]);
        let rounding = 1e-6 * size(before).max(size(after)).max(1e-9);
        let is_like = |value: &Value, rows: &Rows, mut range: RangeInclusive<usize>| {
            range.all(|row| is_near(&rows[row][element], value, rounding))
        };
        !is_near(before, after, 1e4 * rounding)
            && is_like(after, self.right, self.settled())
            && [self.usual, self.still, self.given]
                .iter()
                .all(|rows| is_like(before, rows, self.at..=STEPS))
    }

    /// The root mean square of the differences between two runs in the settled rows.
    fn distance(&self, element: usize, [a, b]: [&Rows; 2]) -> f64 {
        let rows = self.settled();
        let n = rows.clone().count() as f64;
        let real = |rows: &Rows, row: usize| rows[row][element].as_real().unwrap_or(f64::NAN);
        let squares = rows.map(|row| (real(a, row) - real(b, row)).powi(2));
        (squares.sum::<f64>() / n).sqrt()
    }

    /// How much a variable moves in a step of the settled rows, by which an FMU may be late that sees its inputs at the
    /// end of steps.
    fn per_step(&self, element: usize) -> f64 {
        let real = |row: usize| self.right[row][element].as_real().unwrap_or(f64::NAN);
        self.settled().map(|row| (real(row) - real(row - 1)).abs()).fold(0.0, f64::max)
    }

    /// The effect of the jump in model exchange; `None` if it is too small, or if the interfaces differ without it.
    fn effect(&self, element: usize) -> Option<f64> {
        let effect = self.distance(element, [self.right, self.still]);
        let rows = self.right.iter().chain(self.still);
        let scale = rows.map(|row| size(&row[element])).fold(1e-9, f64::max);
        let same = self.distance(element, [self.usual, self.still]) < 0.02 * effect;
        (effect > 1e-3 * scale && same).then_some(effect)
    }

    /// Whether a continuous variable does not follow the jump in co-simulation.
    fn has_no_response(&self, element: usize) -> bool {
        let Some(effect) = self.effect(element) else { return false };
        effect > 3.0 * self.per_step(element)
            && self.distance(element, [self.given, self.usual]) < 0.1 * effect
    }

    /// Whether a continuous variable follows the jump in co-simulation as if its event was not noticed.
    fn has_missed(&self, element: usize) -> bool {
        let (Some(effect), Some(missed)) = (self.effect(element), self.missed) else {
            return false;
        };
        let of_event = self.distance(element, [self.right, missed]);
        of_event > (0.05 * effect).max(3.0 * self.per_step(element))
            && self.distance(element, [self.given, missed]) < 0.1 * of_event
    }
}

/// The jumps of a variable: by several sizes in both directions, or to other values near the start value.
fn jumps<'a>(variable: &'a XmlVariable<'a>) -> Vec<Jump<'a>> {
    const SIZES: [f64; 5] = [1.0, -1.0, 3.0, -3.0, 0.3];
    /// The other jump is a little smaller, for effects that depend on the size.
    const AGAIN: f64 = 0.96;
    if !variable.of_type.is_float() {
        let others = other_values(variable).into_iter();
        return others.map(|values| Jump { variable, again: values.clone(), values }).collect();
    }
    let Some(starts) = starts(variable) else { return Vec::new() };
    let starts: Vec<f64> = starts.iter().filter_map(Value::as_real).collect();
    let (min, max) = real_range(variable);
    let mut jumps: Vec<Jump<'a>> = Vec::new();
    for factor in SIZES {
        let to = |share: f64| -> Option<Vec<Value>> {
            let elements = starts.iter().map(|start| {
                // Not `clamp`, since the XML may be wrong about which is larger.
                let to = (start + factor * usual_change(variable, *start)).max(min).min(max);
                Value::real(variable.of_type, start + share * (to - start))
            });
            elements.collect()
        };
        let [Some(stay), Some(values), Some(again)] = [0.0, 1.0, AGAIN].map(to) else { continue };
        if values != stay && jumps.iter().all(|jump| jump.values != values) {
            jumps.push(Jump { variable, values, again });
        }
    }
    jumps
}
