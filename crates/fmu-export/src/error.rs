//! The errors of calls, from models and from the checks before them, and what follows from an error.

use std::error::Error;
use std::fmt::{self, Arguments, Display, Formatter};

use fmu_description::Number;
use ode_methods::solver::SolverError;

/// An error of a model, with a message for the user.
///
/// The operator `?` converts a text, or any other error with all its causes, to an error of [`ModelError::new`]. Say
/// what failed with [`Context`]:
///
/// ```
/// use fmu_export::prelude::*;
///
/// fn gain(text: &str) -> Result<f64, ModelError> {
///     let gain: f64 = text.trim().parse().with_context(|| format!("the gain {text:?}"))?;
///     if gain < 0.0 {
///         Err("the gain is negative")?;
///     }
///     Ok(gain)
/// }
///
/// assert_eq!(gain("2.5"), Ok(2.5));
/// assert_eq!(gain("x").unwrap_err().reason(), "the gain \"x\": invalid float literal");
/// assert_eq!(gain("-1").unwrap_err().reason(), "the gain is negative");
/// ```
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
        self.with_prefix(format_args!("from t = {:?} s by {:?} s", Number(time), Number(step)))
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

impl Display for ModelError {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(self.reason())
    }
}

impl<E: Into<Box<dyn Error>>> From<E> for ModelError {
    fn from(error: E) -> Self {
        Self::new(in_one_line(&*error.into()))
    }
}

/// The message of an error, followed by those of its causes that it does not repeat.
#[cold]
fn in_one_line(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let words = cause.to_string();
        if !text.contains(&words) {
            text = format!("{text}: {words}");
        }
        next = cause.source();
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Says what failed: `fs::read(path).context("the map of the engine")?`. A missing value becomes an error, too.
///
/// The message comes before the error's, separated by a colon. Errors of [`ModelError::refuse`] and
/// [`ModelError::discard`] remain such.
pub trait Context<T> {
    /// Adds a message.
    ///
    /// # Errors
    /// The value is an error or missing.
    fn context(self, message: impl Display) -> Result<T, ModelError>;

    /// Adds a message that is computed only if it is needed.
    ///
    /// # Errors
    /// The value is an error or missing.
    fn with_context<D: Display>(self, message: impl FnOnce() -> D) -> Result<T, ModelError>;
}

impl<T, E: Into<ModelError>> Context<T> for Result<T, E> {
    fn context(self, message: impl Display) -> Result<T, ModelError> {
        self.with_context(|| message)
    }

    fn with_context<D: Display>(self, message: impl FnOnce() -> D) -> Result<T, ModelError> {
        self.map_err(|error| error.into().with_prefix(format_args!("{}", message())))
    }
}

impl<T> Context<T> for Option<T> {
    fn context(self, message: impl Display) -> Result<T, ModelError> {
        self.with_context(|| message)
    }

    fn with_context<D: Display>(self, message: impl FnOnce() -> D) -> Result<T, ModelError> {
        self.ok_or_else(|| ModelError::new(message()))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn read(file: &str) -> Result<f64, ModelError> {
        let text = std::fs::read_to_string(file).with_context(|| format!("the map {file}"))?;
        let first = text.lines().next().context("the map is empty")?;
        Ok(first.parse()?)
    }

    #[test]
    fn every_error_becomes_one_line_with_its_causes() {
        #[derive(Debug)]
        struct Outer(std::num::ParseIntError);
        impl Display for Outer {
            fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
                f.write_str("line 3:\n  not a row")
            }
        }
        impl Error for Outer {
            fn source(&self) -> Option<&(dyn Error + 'static)> {
                Some(&self.0)
            }
        }
        let cause = "x".parse::<i32>().unwrap_err();
        let error = ModelError::from(Outer(cause.clone()));
        assert_eq!(error.to_string(), "line 3: not a row: invalid digit found in string");
        // As many do, it repeats its cause.
        let repeats = std::io::Error::other(Outer(cause));
        assert_eq!(ModelError::from(repeats), error);
        let boxed: Box<dyn Error> = "a text".into();
        let texts = ["a text".into(), String::from("a text").into(), boxed.into()];
        assert!(texts.iter().all(|error: &ModelError| error.reason() == "a text"));
    }

    #[test]
    fn context_says_what_failed() {
        let missing = read("/no/map.csv").unwrap_err();
        assert!(missing.reason().starts_with("the map /no/map.csv: "), "{missing}");
        let file = tempfile::NamedTempFile::new().unwrap();
        let empty = read(file.path().to_str().unwrap()).unwrap_err();
        assert_eq!(empty.reason(), "the map is empty");
        let discarded = Err::<(), _>(ModelError::discard("too large")).context("the solver");
        let expected = ModelError::discard("the solver: too large");
        assert_eq!(discarded, Err(expected));
    }
}
