//! The methods by which the master integrates equations.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

/// The method by which the equations of a component of model exchange are integrated, with error control.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Solver {
    /// The explicit method of Dormand and Prince.
    #[default]
    Explicit,
    /// The implicit method Rodas5P, for stiff equations.
    Implicit,
}
