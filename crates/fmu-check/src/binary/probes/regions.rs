//! Derivatives and dependencies away from where the usual run goes: late in it, and with inputs and states of other
//! signs and sizes.

use std::time::{Duration, Instant};

use anyhow::Result;
use fmu_description::{Causality, Value, XmlVariable};
use fmu_host::InterfaceType;

use crate::binary::excitation::{real_range, starts, usual_change};
use crate::binary::observed::references;
use crate::binary::run::{Run, is_refusal};
use crate::binary::subject::Subject;

/// Where inputs are: their start values and these shares of their usual change; states are multiplied.
pub const SHARES: [f64; 3] = [-1.0, 3.0, -0.3];
/// Larger states stay where they are: few digits of the derivatives would be left.
const MODERATE: f64 = 1e3;
/// Steps before the first region.
pub const WARM_UP: usize = 15;

/// The value of a continuous input in a region, not at a bound.
pub fn elsewhere(input: &XmlVariable<'_>, share: f64) -> Option<f64> {
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
pub fn set_inputs(run: &mut Run<'_>, share: f64) -> bool {
    run.subject.continuous(Causality::Input).into_iter().all(|input| {
        elsewhere(input, share).is_none_or(|to| run.set(input, &[Value::Float64(to)]).is_ok())
    })
}

/// Makes a test early and late in a run, and then in each region. What the FMU refuses there is no error.
pub fn visit(
    subject: &Subject<'_>,
    mut test: impl FnMut(&mut Run<'_>) -> Result<()>,
) -> Result<()> {
    let mut run = Run::after(subject, WARM_UP)?;
    test(&mut run)?;
    let (begin, limit) = (Instant::now(), Duration::from_secs(subject.task.seconds) / 50);
    let last = subject.all_steps().saturating_sub(SHARES.len() + 1);
    while run.position.point < last && begin.elapsed() < limit && !run.ended {
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
                _ => {
                    let point = run.position.point;
                    run.position.point += 1;
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
