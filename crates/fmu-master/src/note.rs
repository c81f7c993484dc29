//! Notes about a run and advice about an error, as data: each front end words them, as its users know other options.

use std::fmt;

use anyhow::Error;
use serde::{Deserialize, Serialize};

/// A choice of the master that the user may want to override.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Note {
    /// These components are recorded after each step, because all their outputs are discrete.
    RecordedAfterStep(Vec<String>),
    /// These components run as WebAssembly components.
    RunInSandbox(Vec<String>),
    /// Nothing is recorded, because no output is a number or Boolean.
    NothingRecorded {
        /// Some of the variables that can be recorded, with their types.
        recordable: Vec<String>,
        /// The number of the others.
        more: usize,
    },
    /// The step size does not divide the run.
    EndsBeforeStop {
        /// The last communication point (s).
        last: f64,
        /// The stop time (s).
        stop: f64,
    },
}

/// The advice at the end of an error.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Advice {
    /// The variables of this FMU can be listed.
    ListVariables(String),
    /// The file is a system, not a sweep.
    Simulate,
    /// The file is a sweep, not a system.
    Sweep,
    /// The table of a sweep can have another name.
    AnotherTable,
}

impl Advice {
    /// An error that ends with the advice.
    pub(crate) fn after(self, text: String) -> Error {
        Error::new(Advised { text, advice: self })
    }

    /// The advice with which an error ends, if any.
    pub fn of(error: &Error) -> Option<&Self> {
        error.downcast_ref().map(|Advised { advice, .. }| advice)
    }
}

/// An error whose text is to be followed by advice.
#[derive(Debug)]
struct Advised {
    text: String,
    advice: Advice,
}

impl fmt::Display for Advised {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for Advised {}
