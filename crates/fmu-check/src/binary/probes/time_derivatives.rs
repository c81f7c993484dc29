//! Derivatives of inputs and outputs with respect to time, in co-simulation.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value::whole;
use fmu_description::{Causality, XmlVariable};
use fmu_file::text::quote;
use fmu_host::Instance;

use crate::binary::observed::{Row, references};
use crate::binary::probes::dependencies::WARM_UP;
use crate::binary::probes::regions::{SHARES, set_inputs};
use crate::binary::run::{Run, is_refusal};
use crate::binary::subject::{SKIP, Subject};

/// Passes derivatives of inputs: an input that changes by 1 during a step must show where an input that is 1
/// higher does.
pub fn of_inputs(subject: &Subject<'_>) -> Result<()> {
    let inputs = references(&subject.reals(Causality::Input));
    if inputs.is_empty() {
        return Ok(());
    }
    let orders = vec![1; inputs.len()];
    let stepped = |change: f64, derivative: f64| -> Result<_> {
        let mut run = Run::after(subject, WARM_UP)?;
        if change == 0.0 {
            let values = vec![derivative / subject.step; inputs.len()];
            run.instance.set_input_derivatives(&inputs, &orders, &values)?;
        } else {
            let values: Vec<f64> = run.reals(&inputs)?.iter().map(|u| u + change).collect();
            let set = run.instance.set_float64(&inputs, &values);
            set.ok().context(SKIP)?;
        }
        run.instance.do_step(run.time(), subject.step)?;
        Ok(vec![(run.time(), run.observe()?)])
    };
    let (still, rising) = (stepped(0.0, 0.0)?, stepped(0.0, 1.0)?);
    let higher = stepped(1.0, 0.0)?;
    let differs = |run: &[(f64, Row)]| {
        let same = (subject.observed).ensure_same(run, &still, subject.tolerance, [""; 2]);
        same.is_err()
    };
    ensure!(differs(&rising) || !differs(&higher), "derivatives of inputs have no effect");
    Ok(())
}

/// What the FMU declares, if derivatives of outputs are tested.
pub const OUTPUT_DERIVATIVES: &str = "maxOutputDerivativeOrder is not 0, but";

/// Compares derivatives of outputs with their changes, at the start and later, with inputs that do not change.
pub fn of_outputs(subject: &Subject<'_>) -> Result<()> {
    let order = subject.element.attribute("maxOutputDerivativeOrder");
    let outputs = subject.continuous(Causality::Output);
    if order.and_then(whole::<i32>).is_none_or(|order| order <= 0) || outputs.is_empty() {
        return Ok(());
    }
    let mut run = Run::begin(subject, subject.still())?;
    for steps in [0, subject.task.steps] {
        run.advance_by(steps)?;
        ensure!(!run.ended, SKIP);
        compare_slopes(&mut run, &outputs).context(OUTPUT_DERIVATIVES)?;
    }
    output_derivatives(subject, &outputs)
}

/// Compares derivatives of outputs with their changes in a few steps.
pub fn compare_slopes(run: &mut Run<'_>, outputs: &[&XmlVariable<'_>]) -> Result<()> {
    let subject = run.subject;
    let (references, orders) = (references(outputs), vec![1; outputs.len()]);
    let (mut given, mut values) = (Vec::new(), Vec::new());
    for _ in 0..subject.task.steps.min(10) {
        let get = |i: &mut Instance, values: &mut [f64]| {
            i.get_output_derivatives(&references, &orders, values)
        };
        let now = run.instance.read(outputs.len(), get)?;
        ensure!(
            now.iter().all(|value| value.is_finite()),
            "fmi2GetRealOutputDerivatives gave numbers that are not finite"
        );
        given.push(now);
        values.push(run.reals(&references)?);
        run.advance()?;
        if run.ended {
            break;
        }
    }
    for (i, output) in outputs.iter().enumerate() {
        let slopes = values.windows(2).map(|row| (row[1][i] - row[0][i]) / subject.step);
        let judged = given.iter().skip(1).map(|given| given[i]).zip(slopes);
        let wrong = judged.clone().filter(|(given, slope)| {
            let scale = slope.abs().max(given.abs());
            (slope - given).abs() > 0.8 * scale && scale > 1e-6
        });
        // Outputs that jump have other slopes now and then.
        if let Some((given, slope)) = wrong.clone().last()
            && wrong.count() == judged.count().max(3)
        {
            let name = quote(&output.name);
            bail!(
                "the derivative of {name} is {given} while the output changes by {slope} per second"
            );
        }
    }
    Ok(())
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
