//! The errors of calls, from models and from the checks before them, and what follows from an error.

use std::fmt::{Arguments, Display};

use dormand_prince::solver::SolverError;

/// An error of a model, with a message for the user.
///
/// The operator `?` converts any error to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelError(Box<Inner>); // one word, so that a step returns its result in a register

/// What an error says.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Inner {
    reason: String,
    severity: Severity,
}

/// Whether the model remains usable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Severity {
    /// The call was invalid, and the model is unchanged.
    Refused,
    /// The step was not taken, and the model is unchanged.
    Discarded,
    /// The model cannot continue.
    Broken,
}

impl ModelError {
    /// An error after which the model cannot continue (`fmi2Error`).
    pub fn new(reason: impl Display) -> Self {
        Self::with_parts(Severity::Broken, &reason)
    }

    /// The step is invalid, for example its size, and the model is unchanged: the host may continue
    /// with another step (`fmi2Error`).
    pub fn refuse(reason: impl Display) -> Self {
        Self::with_parts(Severity::Refused, &reason)
    }

    /// The step could not be computed, and the model is unchanged: the host may restore an earlier
    /// state and try a smaller step (`fmi2Discard`).
    pub fn discard(reason: impl Display) -> Self {
        Self::with_parts(Severity::Discarded, &reason)
    }

    #[cold]
    #[inline(never)]
    fn with_parts(severity: Severity, reason: &dyn Display) -> Self {
        Self(Box::new(Inner { reason: reason.to_string(), severity }))
    }

    /// The same error of another severity.
    pub(crate) fn with_severity(mut self, severity: Severity) -> Self {
        self.0.severity = severity;
        self
    }

    /// The same error with a message that begins by saying where it happened.
    #[cold]
    #[inline(never)]
    pub(crate) fn with_prefix(self, prefix: Arguments<'_>) -> Self {
        Self::with_parts(self.0.severity, &format_args!("{prefix}: {}", self.0.reason))
    }

    /// The same error of a call that cannot be discarded.
    pub(crate) fn not_discarded(self) -> Self {
        match self.0.severity {
            Severity::Discarded => self.with_severity(Severity::Refused),
            _ => self,
        }
    }

    /// The same error with a message that begins with the step.
    pub(crate) fn in_step(self, time: f64, step: f64) -> Self {
        self.with_prefix(format_args!("from t = {time:?} s by {step:?} s"))
    }

    /// The message for the user.
    pub fn reason(&self) -> &str {
        &self.0.reason
    }

    pub(crate) fn severity(&self) -> Severity {
        self.0.severity
    }
}

impl SolverError for ModelError {
    fn discard(reason: Arguments<'_>) -> Self {
        Self::discard(reason)
    }

    fn is_discarded(&self) -> bool {
        self.0.severity == Severity::Discarded
    }

    fn with_prefix(self, prefix: Arguments<'_>) -> Self {
        self.with_prefix(prefix)
    }
}

impl<E: std::error::Error> From<E> for ModelError {
    fn from(error: E) -> Self {
        Self::new(error)
    }
}

/// The result of a call that is refused, with a message.
macro_rules! refused {
    ($($message:tt)+) => {
        Err($crate::error::ModelError::refuse(format_args!($($message)+)))
    };
}

/// Refuses a call unless a condition holds: `ensure!(step > 0.0, "the step is {step}; expected a positive number")`.
macro_rules! ensure {
    ($condition:expr, $($message:tt)+) => {
        match $condition {
            true => {}
            false => return $crate::error::refused!($($message)+),
        }
    };
}
pub(crate) use {ensure, refused};
