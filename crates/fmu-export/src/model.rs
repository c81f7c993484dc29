//! What an author implements: a struct, the table of its variables, and a step function.

use std::fmt::Display;

use fmu_description::Variable;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A model that can be exported as an FMU.
///
/// Values are stored in the struct; the table declares which of them the host can access. Before
/// [`initialize`](Model::initialize), and again on a reset, the struct is created with `Default`, and
/// every variable with a start value is set to it. The host saves and restores a model through `Clone`
/// and `serde`, so both must cover the complete state.
pub trait Model: Default + Clone + Serialize + DeserializeOwned + 'static {
    /// Name of the model, of the FMU and of its binary: a C identifier.
    const NAME: &'static str;
    /// Description of the model in one sentence.
    const DESCRIPTION: &'static str;
    /// The variables, in the order of the XML.
    const VARIABLES: &'static [Variable<Self>];
    /// Stop time and communication step (s) of the default experiment.
    const DEFAULT_EXPERIMENT: (f64, f64) = (20.0, 0.001);

    /// Computes the outputs at `start_time` (s) from the initial parameters and inputs. If the host
    /// then changes a parameter, it is called again and must start over.
    ///
    /// # Errors
    /// The parameters are inconsistent.
    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        let _ = start_time;
        Ok(())
    }

    /// Advances from `time` to `time + step` (s) with constant inputs. `step` is positive.
    ///
    /// # Errors
    /// The step cannot be computed. The instance can then only be restored, reset or freed, unless
    /// the error leaves the model unchanged: [`ModelError::refuse`] or [`ModelError::discard`].
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError>;
}

/// An error of a model, with a message for the user.
///
/// The operator `?` converts any error to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelError {
    reason: String,
    kind: Kind,
}

/// Whether the model remains usable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The call was invalid, and the model is unchanged.
    Refused,
    /// The step was not taken, and the model is unchanged.
    Discarded,
    /// The model cannot continue.
    Broken,
}

impl ModelError {
    /// An error after which the model cannot continue (`fmi2Error`).
    #[cold]
    #[inline(never)]
    pub fn new(reason: impl Display) -> Self {
        Self {
            reason: reason.to_string(),
            kind: Kind::Broken,
        }
    }

    /// The step is invalid, for example its size, and the model is unchanged: the host may continue
    /// with another step (`fmi2Error`).
    #[cold]
    #[inline(never)]
    pub fn refuse(reason: impl Display) -> Self {
        Self {
            kind: Kind::Refused,
            ..Self::new(reason)
        }
    }

    /// The step could not be computed, and the model is unchanged: the host may restore an earlier
    /// state and try a smaller step (`fmi2Discard`).
    #[cold]
    #[inline(never)]
    pub fn discard(reason: impl Display) -> Self {
        Self {
            kind: Kind::Discarded,
            ..Self::new(reason)
        }
    }

    /// The message for the user.
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

/// Checks that every named value is finite, so that divergence is reported instead of returning NaN.
///
/// # Errors
/// Names the first variable that is not finite, and its value.
pub fn finite(values: &[(&str, f64)]) -> Result<(), ModelError> {
    match values.iter().find(|(_, value)| !value.is_finite()) {
        None => Ok(()),
        Some((name, value)) => Err(ModelError::new(format_args!(
            "{name} became {value}: the simulation diverges"
        ))),
    }
}

/// Like the function [`finite`](fn@crate::finite), but fast enough for every step:
/// `finite!("e": self.e, "u": self.u)`.
///
/// If the sum of the values is finite, all of them are. Otherwise they are checked one by one.
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
