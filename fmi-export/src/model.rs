//! What an author writes: a struct, the table of its variables, and a step.

use std::fmt::Display;

use model_description::Variable;

/// A model that can be exported as an FMU.
///
/// Values live in the struct; the table says which of them the host may see. Before
/// [`initialize`](Model::initialize), and again on a reset, the struct is made by `Default` and every
/// variable of the table that has a start value is set to it.
pub trait Model: Default + 'static {
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
    /// The step cannot be computed. The instance can then only be reset or freed.
    fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError>;
}

/// Why a model cannot go on: a text for the user.
///
/// Any error becomes one by `?`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelError(String);

impl ModelError {
    /// An error that says `reason`.
    pub fn new(reason: impl Display) -> Self {
        Self(reason.to_string())
    }

    /// The text for the user.
    pub fn reason(&self) -> &str {
        &self.0
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
