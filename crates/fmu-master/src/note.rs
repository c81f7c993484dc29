//! Notes about a run and advice about an error, as data: each front end names the options that its users know.

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
    /// The FMUs of these components were compiled from their sources.
    Compiled {
        /// The names of the components.
        components: Vec<String>,
        /// What was left out of the build descriptions.
        left_out: Vec<String>,
    },
    /// Nothing is recorded, because no output is a number or Boolean.
    NothingRecorded {
        /// Some of the variables that can be recorded, with their types.
        recordable: Vec<String>,
        /// The number of the others.
        more: usize,
    },
    /// A deprecated variable is connected or set.
    Deprecated {
        /// Its name in the system.
        variable: String,
        /// What to do instead, as its description says; may be empty.
        instead: String,
    },
    /// Parameters of a parameter set are ignored, because the FMU has no such variables.
    ParametersIgnored {
        /// The component.
        component: String,
        /// The names of the parameters.
        names: Vec<String>,
    },
    /// Nothing ticks these triggered clocks of an FMU that runs alone.
    NeverTick(Vec<String>),
    /// In the order of stepping, no components may step at the same time, for which the user wants threads.
    StepsOneByOne,
    /// The step size does not divide the run.
    EndsBeforeStop {
        /// The last communication point (s).
        last: f64,
        /// The stop time (s).
        stop: f64,
    },
}

/// How a front end tells the users of a run what they can choose instead.
#[derive(Debug, Clone, Copy)]
pub struct NoteOptions {
    /// How to record outputs before each step, such as `use --sampled false`.
    pub record_before: &'static str,
    /// How to record variables, followed by their names, such as `--output can record`.
    pub record: &'static str,
}

impl Note {
    /// The note in a line.
    pub fn text(&self, options: &NoteOptions) -> String {
        match self {
            Self::RecordedAfterStep(components) => {
                let verb = if components.len() == 1 { "is" } else { "are" };
                let (names, before) = (components.join(", "), options.record_before);
                format!("{names} {verb} recorded after each step; {before} for before")
            }
            Self::RunInSandbox(components) => {
                format!("run as WebAssembly components: {}", components.join(", "))
            }
            Self::Compiled { components, left_out } => {
                let mut parts = vec![format!("compiled from sources: {}", components.join(", "))];
                parts.extend_from_slice(left_out);
                parts.join("; ")
            }
            Self::NothingRecorded { recordable, .. } if recordable.is_empty() => {
                "nothing is recorded, because no variable can be recorded".to_owned()
            }
            Self::NothingRecorded { recordable, more } => {
                let (names, record) = (recordable.join(", "), options.record);
                let more = if *more > 0 { format!(", and {more} more") } else { String::new() };
                format!(
                    "nothing is recorded, because no output is a number or Boolean; {record} {names}{more}"
                )
            }
            Self::Deprecated { variable, instead } if instead.is_empty() => {
                format!("{variable} is deprecated")
            }
            Self::Deprecated { variable, instead } => {
                format!("{variable} is deprecated: {instead}")
            }
            Self::ParametersIgnored { component, names } => {
                let names = names.join(", ");
                format!("{component} has no variables {names}, which its parameter set has")
            }
            Self::NeverTick(clocks) => {
                format!(
                    "nothing ticks {}: expected a connection from an output clock, or a column of the input table",
                    clocks.join(", ")
                )
            }
            Self::StepsOneByOne => {
                "threads have no effect, as no components may step at the same time".to_owned()
            }
            Self::EndsBeforeStop { last, stop } => {
                format!(
                    "the step size does not divide the run: it ends at t = {last} s, not at {stop} s"
                )
            }
        }
    }
}

/// The advice at the end of an error.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Advice {
    /// The variables of this FMU can be listed.
    ListVariables(String),
    /// The FMU can be compiled from its sources.
    Compile,
    /// If the equations are stiff, the implicit method takes fewer steps.
    SolveImplicitly,
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
    pub fn in_error(error: &Error) -> Option<&Self> {
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
