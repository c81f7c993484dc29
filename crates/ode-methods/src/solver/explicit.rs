//! The explicit method of Dormand and Prince, for equations that are not stiff.

use super::{IntegrationRun, Method, SolverError, Trial, Workspace};
use crate::dormand_prince::{ERROR, MAX_SHRINKAGE, NODES, WEIGHTS, interpolate, weighted};

/// The explicit method of order 5(4) of Dormand and Prince, see [`dormand_prince`](crate::dormand_prince).
#[derive(Debug, Clone, Copy)]
pub struct DormandPrince;

impl Method for DormandPrince {
    const IS_IMPLICIT: bool = false;

    fn try_step<E: SolverError>(
        run: &mut IntegrationRun<'_, E, Self>,
        h: f64,
        to: f64,
    ) -> Result<Trial<E>, E> {
        for (stage, weights) in WEIGHTS.iter().enumerate().skip(1) {
            for i in 0..run.w.states.len() {
                let slope = weighted(weights, &run.w.slopes, i);
                run.w.next[i] = run.w.states[i] + h * slope;
            }
            let time = match NODES[stage] {
                1.0 => to,
                node => run.reached + node * h,
            };
            let evaluated = run.system.evaluate(run.step.time + time, &run.w.next);
            if let Some(failed) = run.judge(evaluated)? {
                return Ok(failed);
            }
            run.system.derivatives(&mut run.w.slopes[stage]);
        }
        let w = &run.w;
        Ok(Trial::Error(run.norm(|i| {
            let largest = w.states[i].abs().max(w.next[i].abs());
            h * weighted(&ERROR, &w.slopes, i) / run.scale(i, largest)
        })))
    }

    fn interpolate(w: &mut Workspace, fraction: f64, h: f64) {
        for (i, point) in w.point.iter_mut().enumerate() {
            *point = interpolate(fraction, h, (w.states[i], w.next[i]), &w.slopes, i);
        }
    }

    /// From the first two derivatives (Hairer, Nørsett and Wanner, section II.4).
    fn estimate_size<E: SolverError>(
        run: &mut IntegrationRun<'_, E, Self>,
        remaining: f64,
    ) -> Result<f64, E> {
        let w = &run.w;
        let relative = |value: f64, i: usize| value / run.scale(i, w.states[i].abs());
        let size = run.norm(|i| relative(w.states[i], i));
        let slope = run.norm(|i| relative(w.slopes[0][i], i));
        let is_known = size > 1e-5 && slope > 1e-5;
        let probe = if is_known { remaining.min(0.01 * size / slope) } else { 1e-3 * remaining };
        for i in 0..run.w.states.len() {
            run.w.point[i] = run.w.states[i] + probe * run.w.slopes[0][i];
        }
        let time = run.now() + probe;
        let evaluated = run.system.evaluate(time, &run.w.point);
        if run.judge(evaluated)?.is_some() {
            return Ok(probe * MAX_SHRINKAGE);
        }
        run.system.derivatives(&mut run.w.slopes[1]);
        let w = &run.w;
        let relative = |value: f64, i: usize| value / run.scale(i, w.states[i].abs());
        let change = run.norm(|i| relative(w.slopes[1][i] - w.slopes[0][i], i)) / probe;
        let size = libm::pow(0.01 / change.max(slope).max(1e-15), 0.2);
        Ok(if is_known { size.min(100.0 * probe) } else { size })
    }

    fn resolution<E>(run: &IntegrationRun<'_, E, Self>) -> f64 {
        4.0 * f64::EPSILON * (run.step.time.abs() + run.step.size)
    }
}
