//! The control of communication steps by an estimate of their error, and what a run has needed.

use serde::{Deserialize, Serialize};

/// A PI controller of step sizes (K. Gustafsson, 1991), for an error that grows with the square of the step.
#[derive(Debug)]
pub(crate) struct StepControl {
    /// The size of the next step (s), and the bounds of sizes.
    pub(crate) size: f64,
    smallest: f64,
    largest: f64,
    /// The error of the last step that was accepted, and whether one was rejected since.
    last: f64,
    is_rejected: bool,
    pub(crate) steps: AdaptiveSteps,
}

/// The adaptive steps of a run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct AdaptiveSteps {
    /// The number of steps that were accepted.
    pub accepted: u64,
    /// The number of steps that were repeated, because their error was too large.
    pub rejected: u64,
    /// The size of the smallest accepted step, and the time from which it was taken (s).
    pub smallest: Option<(f64, f64)>,
    /// The number of accepted steps whose error was too large, as they could not be smaller.
    pub missed: u64,
}

/// The exponents of the errors of the last steps: of a rejected step, and of the last two that were accepted.
const REJECTED: f64 = 0.5;
const ACCEPTED: [f64; 2] = [0.35, 0.2];
/// The part of the size that the errors allow, and the largest changes of a size.
const SAFETY: f64 = 0.9;
const CHANGES: [f64; 2] = [0.2, 5.0];
/// The smallest error that matters.
const NEGLIGIBLE: f64 = 1e-8;

impl StepControl {
    /// A control between two sizes (s), from the largest.
    pub(crate) fn new(smallest: f64, largest: f64) -> Self {
        let steps = AdaptiveSteps::default();
        Self { size: largest, smallest, largest, last: 1.0, is_rejected: false, steps }
    }

    /// Whether a step of this size (s) from a time (s) is accepted, with this error relative to the one that is allowed;
    /// chooses the next size.
    pub(crate) fn accepts(&mut self, error: f64, time: f64, size: f64) -> bool {
        let fits = error <= 1.0;
        let is_accepted = fits || size <= self.smallest * (1.0 + 1e-9);
        let bounded = if error.is_finite() { error.max(NEGLIGIBLE) } else { f64::INFINITY };
        let change = match fits {
            true => libm::pow(bounded, -ACCEPTED[0]) * libm::pow(self.last, ACCEPTED[1]),
            false => libm::pow(bounded, -REJECTED),
        };
        let most = if self.is_rejected || !fits { 1.0 } else { CHANGES[1] };
        let change = (SAFETY * change).clamp(CHANGES[0], most);
        self.size = (size * change).clamp(self.smallest, self.largest);
        self.is_rejected = !is_accepted;
        let steps = &mut self.steps;
        if !is_accepted {
            steps.rejected += 1;
            return false;
        }
        self.last = bounded.min(1.0);
        steps.accepted += 1;
        steps.missed += u64::from(!fits);
        if steps.smallest.is_none_or(|(smallest, _)| size < smallest) {
            steps.smallest = Some((size, time));
        }
        true
    }
}

impl std::fmt::Display for AdaptiveSteps {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { accepted, rejected, smallest, missed } = self;
        write!(f, "adaptive steps: {accepted} accepted, {rejected} rejected")?;
        if let Some((size, time)) = smallest {
            write!(f, ", the smallest of {size:.3e} s at t = {time:?} s")?;
        }
        match missed {
            0 => Ok(()),
            missed => {
                write!(f, "; {missed} with a larger error than allowed, as min_step is reached")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_find_the_size_at_which_the_error_is_allowed() {
        // The error is (size / 0.01)^2.
        let mut control = StepControl::new(1e-9, 10.0);
        let (mut time, mut sizes) = (0.0, Vec::new());
        for _ in 0..40 {
            let size = control.size;
            if control.accepts((size / 0.01) * (size / 0.01), time, size) {
                time += size;
                sizes.push(size);
            }
        }
        assert!(sizes.iter().all(|size| *size <= 0.01));
        assert!(sizes[10..].iter().all(|size| *size > 0.005), "{sizes:?}");
        assert_eq!(control.steps.accepted as usize, sizes.len());
        assert_eq!(control.steps.missed, 0);
    }

    #[test]
    fn the_smallest_step_is_accepted_and_counted() {
        let mut control = StepControl::new(0.25, 1.0);
        assert!(!control.accepts(f64::NAN, 0.0, 1.0));
        assert_eq!(control.size, 0.25);
        assert!(control.accepts(1e6, 0.0, 0.25));
        let AdaptiveSteps { accepted, rejected, missed, smallest } = control.steps;
        assert_eq!((accepted, rejected, missed, smallest), (1, 1, 1, Some((0.25, 0.0))));
    }
}
