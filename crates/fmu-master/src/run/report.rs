//! The messages about a run from the worker side to the supervisor side.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::completed::Completed;
use crate::curve::Curve;
use crate::function::FunctionCall;
use crate::{Column, Experiment, Note, Row, RunError};

/// A message of a worker about its run.
#[derive(Serialize, Deserialize)]
pub(crate) enum Report<'a> {
    /// A warning about the system.
    Warning(Cow<'a, str>),
    /// The run is about to begin.
    Ready(Ready),
    /// A row.
    Row(Cow<'a, Row>),
    /// The run needs the outputs of a function.
    Call(FunctionCall),
    /// The run has reached its end.
    Completed(Box<Completed>),
    /// The run has failed, or cannot begin.
    Failed(Box<RunError>),
}

/// A run that is about to begin.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Ready {
    /// The names of the components and of their files.
    pub components: Vec<(String, String)>,
    /// Whether the run is paced by the clock.
    pub is_paced: bool,
    /// The times of the run.
    pub experiment: Experiment,
    /// The recorded variables.
    pub columns: Vec<Column>,
    /// How a plot draws them.
    pub curves: Vec<Curve>,
    /// Choices of the master that the user may want to override.
    pub notes: Vec<Note>,
}
