//! The times of a simulation: its communication points.

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};

use crate::note::Note;

/// The times of a simulation (s).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Experiment {
    /// The first communication point.
    pub start: f64,
    /// The last communication point that is recorded.
    pub stop: f64,
    /// The communication step.
    pub step: f64,
}

/// Maximum number of steps; more are assumed to be a mistake in `step` or `stop`.
const MAX_STEPS: f64 = 1e9;

impl Experiment {
    /// The step of an FMU for which there is none (s).
    pub(crate) fn derived_step(start: f64, stop: f64) -> f64 {
        (stop - start) / 500.0
    }

    /// The number of communication points `start + k step` up to `stop`.
    ///
    /// # Errors
    /// The times are inconsistent.
    pub fn steps(&self) -> Result<u64> {
        let Self { start, stop, step } = *self;
        for (key, time) in [("start", start), ("stop", stop)] {
            ensure!(time.is_finite(), "{key} = {time:?}, expected a finite time in s");
        }
        ensure!(stop >= start, "stop = {stop:?}, expected at least start = {start:?}");
        ensure!(step.is_finite() && step > 0.0, "step = {step:?}, expected a positive number of s");
        let steps = (stop - start) / step;
        ensure!(
            steps <= MAX_STEPS,
            "step = {step:?}, which makes {steps:.3e} steps; expected at most {MAX_STEPS:.0e}"
        );
        let largest = start.abs().max(stop.abs());
        ensure!(
            steps < 1.0 || step > largest * f64::EPSILON,
            "step = {step:?} is too short to tell times near {largest:?} s apart"
        );
        // Rounding may put the last point just past the stop time.
        let rounding = (largest * f64::EPSILON / step).max(1e-6);
        Ok((steps + rounding).floor() as u64 + 1)
    }

    /// The last communication point.
    pub(crate) fn last(&self) -> Result<f64> {
        Ok(self.time(self.steps()? - 1))
    }

    /// A note if the last communication point is before the stop time.
    pub(crate) fn note(&self) -> Result<Option<Note>> {
        let (last, stop) = (self.last()?, self.stop);
        let is_short = stop - last > 1e-3 * self.step;
        Ok(is_short.then(|| Note::EndsBeforeStop { last: Self::rounded(last), stop }))
    }

    /// A time (s) for people, without the many nines or zeros with which the sum or difference of two times may end.
    pub fn rounded(time: f64) -> f64 {
        (time * 1e9).round() / 1e9
    }

    /// The communication point of step `k`, computed directly so that rounding errors do not add up.
    #[inline]
    pub fn time(&self, k: u64) -> f64 {
        // Processors convert signed numbers in one instruction; no run has 2^63 steps.
        self.start + k as i64 as f64 * self.step
    }
}
