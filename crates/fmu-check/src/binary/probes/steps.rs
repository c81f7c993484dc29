//! The same run with communication steps of several sizes.

use anyhow::{Context, Result, bail, ensure};
use fmu_description::XmlVariable;

use crate::binary::observed::{Row, element_name, is_near, shown, size};
use crate::binary::run::Run;
use crate::binary::subject::{SKIP, Subject};
use crate::rules::is_continuous;

/// The sizes of long steps, in usual steps; all divide the last one, and it the length of the runs.
const SIZES: [usize; 6] = [2, 5, 10, 20, 50, 100];
/// The communication point whose inputs the runs keep.
const POINT: usize = 10;
/// The least difference that is looked for, relative to the largest value.
const LEAST: f64 = 1e-2;
/// How much more the results must differ than those with the next shorter steps. From each of [`SIZES`] to the next,
/// the error of a method of the fifth order grows by a factor of 98.
const GROWTH: f64 = 1e3;

/// Takes longer and longer steps with inputs that keep their values. A solver whose steps are the communication steps
/// errs more and more; what errs all at once has samples or events in a wrong order, or misses some.
pub fn long_steps(subject: &Subject<'_>) -> Result<()> {
    // A step must not pass over ticks.
    ensure!(subject.clocks.is_empty(), SKIP);
    let Some(longest) = SIZES.into_iter().rev().find(|size| *size <= subject.task.steps) else {
        return Ok(());
    };
    let steps = subject.task.steps / longest * longest;
    let run = |size| rows(subject, steps, size).ok().context(SKIP);
    let usual = run(1.0)?;
    let compare = |rows: &[Row], every: usize| Differences::new(subject, &usual, rows, every);
    let halves: Vec<Row> = run(0.5)?.into_iter().step_by(2).collect();
    let mut before = compare(&halves, 1);
    for size in SIZES.into_iter().filter(|size| longest % size == 0) {
        let rows = run(size as f64)?;
        let differences = compare(&rows, size);
        for (element, (variable, index)) in subject.observed.elements().enumerate() {
            if differences.are_sudden(&before, element, variable) {
                let last = rows.len() - 1;
                let [is, expected] =
                    [&rows[last], &usual[last * size]].map(|row| shown(&row[element]));
                bail!(
                    "with steps of {} s, {} at t = {} s is {is}, expected {expected} as with steps of {} s",
                    size as f64 * subject.step,
                    element_name(variable, index),
                    subject.start + (last * size) as f64 * subject.step,
                    subject.step
                );
            }
        }
        before = differences;
    }
    Ok(())
}

/// The values after each step of a run; sizes of steps are in usual steps.
fn rows(subject: &Subject<'_>, steps: usize, size: f64) -> Result<Vec<Row>> {
    let setup = subject.setup();
    let mut run = Run::initializing(subject, setup)?;
    for input in &subject.inputs {
        if let Some(values) = input.values(setup.excitation, setup.seed, POINT) {
            run.set(input.variable, &values)?;
        }
    }
    run.instance.exit_initialization_mode()?;
    let mut rows = vec![run.observe()?];
    for k in 0..(steps as f64 / size).round() as usize {
        run.do_step(k as f64 * size, size)?;
        rows.push(run.observe()?);
    }
    Ok(rows)
}

/// How much two runs differ.
struct Differences {
    /// The largest and the last difference of each element, relative to the largest value.
    of_elements: Vec<[f64; 2]>,
    /// The largest difference of a continuous variable.
    continuous: f64,
}

impl Differences {
    /// Compares a run with every few rows of the usual one.
    fn new(subject: &Subject<'_>, usual: &[Row], rows: &[Row], every: usize) -> Self {
        let mut continuous: f64 = 0.0;
        let of_element = |(element, (variable, _)): (usize, (&XmlVariable<'_>, usize))| {
            let usual_rows = usual.iter().step_by(every);
            let values = rows.iter().chain(usual).map(|row| size(&row[element]));
            let scale = values.fold(1e-9, f64::max);
            let differences = rows.iter().zip(usual_rows).map(|(row, usual)| {
                let [a, b] = [&row[element], &usual[element]];
                let numbers = a.as_real().zip(b.as_real());
                match numbers.map(|(a, b)| (a - b).abs() / scale) {
                    Some(difference) if difference.is_finite() => difference,
                    _ => f64::from(!is_near(a, b, 0.0)),
                }
            });
            let (largest, last) =
                differences.fold((0.0, 0.0), |(largest, _), now| (f64::max(largest, now), now));
            if is_continuous(variable) {
                continuous = continuous.max(largest);
            }
            [largest, last]
        };
        let of_elements = subject.observed.elements().enumerate().map(of_element).collect();
        Self { of_elements, continuous }
    }

    /// Whether an element differs, unlike with the next shorter steps. A discrete variable may follow a continuous one,
    /// in which the solver errs.
    fn are_sudden(&self, before: &Self, element: usize, variable: &XmlVariable<'_>) -> bool {
        let ([_, last], [largest, _]) = (self.of_elements[element], before.of_elements[element]);
        let error = if is_continuous(variable) { largest } else { before.continuous.max(largest) };
        last > LEAST.max(GROWTH * error)
    }
}
