//! Clocks: intervals as fractions, clocked variables outside of ticks, and model partitions.

use anyhow::{Context, Result, ensure};
use fmu_description::Value;
use fmu_file::text::quote;

use super::misuse::{Refused, refuse, unknown};
use super::same_with;
use crate::binary::observed::get;
use crate::binary::report::check;
use crate::binary::run::Run;
use crate::binary::schedule::clock_type;
use crate::binary::subject::{SKIP, Subject};
use crate::rule::rule;

/// Compares intervals and shifts with their fractions, in instances of their own, since an interval is new once.
pub fn fractions(subject: &Subject<'_>) -> Result<()> {
    let clocks = subject.clocks.inputs.iter();
    let clocks = clocks.map(|clock| (clock, clock_type(clock)));
    for (clock, of) in clocks.filter(|(_, of)| of.supports_fraction) {
        let (name, clocks) = (quote(&clock.name), [clock.reference]);
        let is_periodic = of.interval_variability.is_periodic();
        let compare = |what: &str, decimal: f64, (counter, resolution): (u64, u64)| {
            let fraction = counter as f64 / resolution as f64;
            let fits = (decimal - fraction).abs() <= 1e-9 * fraction.abs();
            check!(subject, "interval-fraction": fits,
                "the {what} of {name} is {counter}/{resolution} s as a fraction, expected {decimal} s");
        };
        let mut one = Run::initializing(subject, subject.setup())?;
        let (mut counter, mut resolution, mut qualifier) = ([0], [0], [-1]);
        let got = one.instance.get_interval_fraction(
            &clocks,
            &mut counter,
            &mut resolution,
            &mut qualifier,
        );
        check!(subject, "interval-fraction": got.is_ok(),
            "supportsFraction is true, but fmi3GetIntervalFraction refuses {name}");
        drop(one);
        let mut two = Run::initializing(subject, subject.setup())?;
        let (mut decimal, mut of_decimal) = ([0.0], [-1]);
        let as_decimal = two.instance.get_interval_decimal(&clocks, &mut decimal, &mut of_decimal);
        // Without an interval, there is nothing to compare.
        if got.is_ok() && as_decimal.is_ok() && qualifier == of_decimal && qualifier[0] != 0 {
            compare("interval", decimal[0], (counter[0], resolution[0]));
        }
        if is_periodic && two.instance.get_shift_decimal(&clocks, &mut decimal).is_ok() {
            let got = two.instance.get_shift_fraction(&clocks, &mut counter, &mut resolution);
            check!(subject, "interval-fraction": got.is_ok(),
                "supportsFraction is true, but fmi3GetShiftFraction refuses {name}");
            if got.is_ok() {
                compare("shift", decimal[0], (counter[0], resolution[0]));
            }
        }
    }
    Ok(())
}

/// Reads clocked variables between their ticks. The FMU may refuse that.
pub fn kept(subject: &Subject<'_>) -> Result<()> {
    let mut run = Run::begin(subject, subject.setup())?;
    let mut refused = Vec::new();
    for _ in 0..subject.task.steps {
        run.advance()?;
        if run.ended {
            return Ok(());
        }
        let time = run.time();
        let mut changed = None;
        run.at_event(|run| {
            let mut at = 0;
            for variable in subject.observed.held() {
                let n = variable.element_count();
                let held = &run.position.schedule.held[at..at + n];
                at += n;
                if refused.contains(&variable.reference)
                    || !run.position.schedule.read.contains(&variable.reference)
                {
                    continue;
                }
                match get(&mut run.instance, variable.of_type, &[variable.reference], n) {
                    Err(_) => refused.push(variable.reference),
                    Ok(values) if values == held => {}
                    Ok(values) => changed = Some((variable, values, held.to_vec())),
                }
            }
            Ok(())
        })
        // A call that the FMU has refused may have ended the simulation.
        .map_err(|error| if refused.is_empty() { error } else { error.context(SKIP) })?;
        if let Some((variable, values, held)) = changed {
            let [now, then] = [values, held].map(|values| shown(&values));
            check!(subject, "clocked-kept": false,
                "{} is {now} at t = {time} s, expected {then} as at the last tick of its clocks", quote(&variable.name));
            return Ok(());
        }
        ensure!(refused.is_empty(), SKIP);
    }
    Ok(())
}

fn shown(values: &[Value]) -> String {
    let all = values.iter().map(crate::binary::observed::shown);
    all.collect::<Vec<_>>().join(" ")
}

/// Sets clocked inputs in event mode while no clock is active.
pub fn settable(subject: &Subject<'_>) -> Result<()> {
    let mut refused = Refused::new(subject);
    for input in &subject.clocks.clocked {
        let Some(values) = crate::binary::excitation::starts(input.variable) else { continue };
        let what = format!(
            "setting {} in event mode while its clocks are inactive",
            quote(&input.variable.name)
        );
        refused.call(what, Run::stepped, |run| -> Result<()> {
            run.instance.enter_event_mode().ok().context(SKIP)?;
            run.set(input.variable, &values)?;
            Ok(())
        })?;
    }
    refused.report(rule!("clocked-settable"))
}

/// Reads clocks that do not exist, and activates output clocks.
pub fn references(subject: &Subject<'_>) -> Result<()> {
    ensure!(subject.setup().event_mode, SKIP);
    let unknown = unknown(subject);
    let in_event_mode = |subject, setup| -> Result<_> {
        let mut run = Run::stepped(subject, setup)?;
        run.instance.enter_event_mode()?;
        Ok(run)
    };
    let mut refused = Refused::new(subject);
    let what = format!("fmi3GetClock for the unknown value reference {unknown}");
    refused.call(what, in_event_mode, |run| run.instance.get_clock(&[unknown], &mut [0]))?;
    let what = format!("fmi3SetClock for the unknown value reference {unknown}");
    refused.call(what, in_event_mode, |run| run.instance.set_clock(&[unknown], &[1]))?;
    refused.report(rule!("unknown-references"))?;
    let mut refused = Refused::new(subject);
    if let Some(clock) = subject.clocks.outputs.first() {
        let what =
            format!("fmi3SetClock in event mode for {}, an output clock", quote(&clock.name));
        refused
            .call(what, in_event_mode, |run| run.instance.set_clock(&[clock.reference], &[1]))?;
    }
    refused.report(rule!("settable"))
}

/// Evaluates discrete states before they are read, twice.
pub fn evaluated(subject: &Subject<'_>) -> Result<()> {
    ensure!(!subject.clocks.is_empty(), SKIP);
    let how = ["with fmi3EvaluateDiscreteStates", " as without"];
    same_with(subject, how, super::ROUNDING, |setup| setup.evaluates = true)
}

/// Activates model partitions in wrong states, at an earlier time, and of what is no input clock.
pub fn partitions(subject: &Subject<'_>) -> Result<()> {
    let (start, step) = (subject.start, subject.step);
    let Some(clock) = subject.clocks.inputs.first().map(|clock| clock.reference) else {
        return Ok(());
    };
    let outputs = subject.clocks.outputs.iter().map(|clock| (clock, "an output clock"));
    refuse! { subject, "partition-order":
        "fmi3ActivateModelPartition before initialization", Run::instantiate,
            |run| run.instance.activate_model_partition(clock, start);
        "fmi3ActivateModelPartition in initialization mode", Run::initializing,
            |run| run.instance.activate_model_partition(clock, start);
        "fmi3ActivateModelPartition after fmi3Terminate", Run::terminated,
            |run| run.instance.activate_model_partition(clock, start + 10.0 * step);
        "fmi3ActivateModelPartition at an earlier time", |subject, setup| {
                let mut run = Run::begin(subject, setup)?;
                run.instance.activate_model_partition(clock, start + 100.0 * step)?;
                Ok(run)
            },
            |run| run.instance.activate_model_partition(clock, start + 99.0 * step);
    }?;
    let mut refused = Refused::new(subject);
    let reference = unknown(subject);
    let what = format!("fmi3ActivateModelPartition for the unknown value reference {reference}");
    let time = start + 10.0 * step;
    refused.call(what, Run::begin, |run| run.instance.activate_model_partition(reference, time))?;
    for (clock, is) in outputs.take(1) {
        let what = format!("fmi3ActivateModelPartition for {}, {is}", quote(&clock.name));
        refused.call(what, Run::begin, |run| {
            run.instance.activate_model_partition(clock.reference, time)
        })?;
    }
    refused.report(rule!("partition-order"))
}
