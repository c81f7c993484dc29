//! The rate of a component: a step of its own, and how often it steps in a communication step of the system, or in how
//! many of them; and what its inputs are meanwhile.

use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};

/// The step of a component as the user writes it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(from = "Notation")]
pub enum ComponentStep {
    /// A step in s.
    Size(f64),
    /// The step of the default experiment of its FMU.
    DefaultExperiment,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected a number of s, or \"default experiment\"")]
enum Notation {
    Size(f64),
    Named(NamedStep),
}

#[derive(Deserialize)]
enum NamedStep {
    #[serde(rename = "default experiment")]
    DefaultExperiment,
}

impl From<Notation> for ComponentStep {
    fn from(notation: Notation) -> Self {
        match notation {
            Notation::Size(size) => Self::Size(size),
            Notation::Named(NamedStep::DefaultExperiment) => Self::DefaultExperiment,
        }
    }
}

/// What the inputs of a component are between communication points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Inputs {
    /// The values that were set last.
    #[default]
    Held,
    /// By the derivatives of the outputs that feed them, if they are continuous and have derivatives.
    Extrapolated,
}

/// How the steps of a component fit the communication steps of the system: one of the two numbers is 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rate {
    /// Its step (s).
    pub(crate) step: f64,
    /// The number of its steps in a communication step.
    pub(crate) steps: u64,
    /// The number of communication steps in one of its steps.
    pub(crate) every: u64,
}

/// The largest ratio of two steps, as many as the steps of a run; a larger one is assumed to be a mistake.
const LARGEST: f64 = 1e9;
/// How far the ratio of two steps may be from a whole number, of this number. Over a whole run, the times then differ by
/// less than a step.
const ROUNDING: f64 = 1e-9;

impl Rate {
    /// The rate of a component that steps with the system, whose communication step is this (s).
    pub(crate) fn of_system(step: f64) -> Self {
        Self { step, steps: 1, every: 1 }
    }

    /// The rate of a component with a step (s), in a system with this communication step (s).
    ///
    /// # Errors
    /// The step is neither a multiple nor a whole fraction of the communication step.
    pub(crate) fn new(step: f64, communication_step: f64) -> Result<Self> {
        ensure!(step.is_finite() && step > 0.0, "step = {step:?}, expected a positive number of s");
        let fits = match step > communication_step {
            true => ratio(step, communication_step).map(|every| (1, every)),
            false => ratio(communication_step, step).map(|steps| (steps, 1)),
        };
        let (steps, every) = fits.with_context(|| {
            format!(
                "step = {step:?}, expected a multiple or a whole fraction of the communication step, {communication_step:?} s, and a ratio of at most {LARGEST:.0e}"
            )
        })?;
        let rate = Self { step, steps, every };
        Ok(if rate.is_of_system() { Self::of_system(communication_step) } else { rate })
    }

    /// Whether the component steps with the system.
    pub(crate) fn is_of_system(&self) -> bool {
        self.steps == 1 && self.every == 1
    }

    /// Whether the component steps from communication point `k`.
    pub(crate) fn is_due(&self, k: u64) -> bool {
        k.is_multiple_of(self.every)
    }

    /// Whether communication step `k` ends where a step of the component ends.
    pub(crate) fn ends(&self, k: u64) -> bool {
        self.is_due(k + 1)
    }

    /// The times (s) from which it steps in communication step `k`, in which it is due; the run begins at `start` (s).
    pub(crate) fn times(&self, k: u64, start: f64) -> impl Iterator<Item = f64> + use<> {
        let Self { step, steps, every } = *self;
        let first = k / every * steps;
        // As the communication points, so that equal times have equal bits.
        (first..first + steps).map(move |step_of_run| start + step_of_run as i64 as f64 * step)
    }
}

/// How many times the shorter of two steps fits into the longer one, if that is a whole number.
pub(crate) fn ratio(longer: f64, shorter: f64) -> Option<u64> {
    let ratio = longer / shorter;
    let whole = ratio.round();
    let fits = (1.0..=LARGEST).contains(&whole) && (ratio - whole).abs() <= ROUNDING * whole;
    fits.then_some(whole as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_a_multiple_or_a_fraction_of_the_communication_step() {
        let rate = |step| Rate::new(step, 1e-3).map(|rate| (rate.steps, rate.every));
        assert_eq!(rate(1e-4).unwrap(), (10, 1));
        assert_eq!(rate(0.05).unwrap(), (1, 50));
        assert_eq!(rate(1e-3 / 3.0).unwrap(), (3, 1));
        // Equal but for rounding: the bits of the communication step.
        assert_eq!(Rate::new(0.1 + 0.2, 0.3).unwrap(), Rate::of_system(0.3));
        for step in [3e-4, 1.5e-3, 1e-13, 1e7, 0.0, -1e-3, f64::NAN, f64::INFINITY] {
            let error = rate(step).unwrap_err().to_string();
            assert!(error.starts_with(&format!("step = {step:?}, expected a ")), "{error}");
        }
    }

    #[test]
    fn the_times_of_a_component_are_those_of_a_system_with_its_step() {
        let times = |rate: Rate, k| Vec::from_iter(rate.times(k, 1.0));
        let fast = Rate::new(1e-4, 1e-3).unwrap();
        assert_eq!(times(fast, 7), Vec::from_iter((70..80).map(|k| 1.0 + k as f64 * 1e-4)));
        let slow = Rate::new(0.05, 1e-3).unwrap();
        assert_eq!(times(slow, 100), [1.0 + 2.0 * 0.05]);
        let is_due = |k| (slow.is_due(k), slow.ends(k));
        assert_eq!(
            [0, 1, 49, 50].map(is_due),
            [(true, false), (false, false), (false, true), (true, false)]
        );
    }
}
