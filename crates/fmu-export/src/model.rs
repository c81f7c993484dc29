//! What an author writes: a struct, the table of its variables, and a step.

use std::fmt::Display;

use fmu_description::Variable;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A model that can be exported as an FMU.
///
/// Values live in the struct; the table says which of them the host may see. Before
/// [`initialize`](Model::initialize), and again on a reset, the struct is made by `Default` and every
/// variable of the table that has a start value is set to it. `Clone` and `serde` are how the host
/// saves and restores a model: whatever its future depends on is cloned and serialized.
pub trait Model: Default + Clone + Serialize + DeserializeOwned + 'static {
    /// Name of the model, of the FMU and of its binary: a C identifier.
    const NAME: &'static str;
    /// What the model is, in a sentence.
    const DESCRIPTION: &'static str;
    /// The variables, in the order of the XML.
    const VARIABLES: &'static [Variable<Self>];
    /// Stop time and communication step (s) that suit the model.
    const DEFAULT_EXPERIMENT: (f64, f64) = (20.0, 0.001);

    /// Called when parameters and inputs have their first values: computes the outputs at
    /// `start_time` (s). It may be called again, after the host has changed its mind about a
    /// parameter, and then starts anew.
    ///
    /// # Errors
    /// The parameters do not fit together.
    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        let _ = start_time;
        Ok(())
    }

    /// Moves on from `time` to `time + step` (s), with the inputs held. `step` is positive.
    ///
    /// # Errors
    /// The step cannot be computed. The instance can then only be restored, reset or freed, unless
    /// the error is one that leaves the model as it was: [`ModelError::refuse`] or
    /// [`ModelError::discard`].
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError>;
}

/// Why a model cannot go on: a text for the user.
///
/// Any error becomes one by `?`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelError {
    reason: String,
    kind: Kind,
}

/// What is left of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The call was wrong, and left the model as it was.
    Refused,
    /// The step was not taken, and left the model as it was.
    Discarded,
    /// The model cannot go on.
    Broken,
}

impl ModelError {
    /// An error after which the model cannot go on (`fmi2Error`).
    #[cold]
    #[inline(never)]
    pub fn new(reason: impl Display) -> Self {
        Self {
            reason: reason.to_string(),
            kind: Kind::Broken,
        }
    }

    /// A step that the model never takes, such as one of a wrong size, and that left it as it was:
    /// the host may go on with another (`fmi2Error`).
    #[cold]
    #[inline(never)]
    pub fn refuse(reason: impl Display) -> Self {
        Self {
            kind: Kind::Refused,
            ..Self::new(reason)
        }
    }

    /// A step that could not be taken here, and left the model as it was: the host may restore an
    /// earlier state, and try a smaller one (`fmi2Discard`).
    #[cold]
    #[inline(never)]
    pub fn discard(reason: impl Display) -> Self {
        Self {
            kind: Kind::Discarded,
            ..Self::new(reason)
        }
    }

    /// The text for the user.
    pub fn reason(&self) -> &str {
        &self.reason
    }

    pub(crate) fn kind(&self) -> Kind {
        self.kind
    }
}

impl<E: std::error::Error> From<E> for ModelError {
    fn from(error: E) -> Self {
        Self::new(error)
    }
}

/// Checks that every named value is a finite number, so that a model that diverges tells it instead
/// of handing out NaN.
///
/// # Errors
/// Names the first variable that is not, and its value.
pub fn finite(values: &[(&str, f64)]) -> Result<(), ModelError> {
    match values.iter().find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some((name, value)) => Err(ModelError::new(format_args!(
            "{name} became {value}: the simulation diverges"
        ))),
    }
}

/// As the function [`finite`](fn@crate::finite), for a check at every step:
/// `finite!("e": self.e, "u": self.u)`.
///
/// A sum is finite only if all its parts are; only else they are looked at one by one.
#[macro_export]
macro_rules! finite {
    ($($name:literal: $value:expr),+ $(,)?) => {
        if (0.0 $(+ $value)+).is_finite() {
            Ok(())
        } else {
            $crate::finite(&[$(($name, $value)),+])
        }
    };
}
