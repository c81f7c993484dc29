//! The contents of a sweep file (docs/sweeps.md).

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, anyhow};
use serde::{Deserialize, Serialize};

use super::metrics::Criteria;
use super::parameter::Parameter;
use super::signals::SignalNames;
use crate::similar::with_similar_file;
use crate::{Advice, Literal, Order, Overrides, Signature, is_fmu};

/// A sweep as the user gives it.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct SweepSource {
    /// The sweep file.
    pub file: PathBuf,
    /// The text of a sweep file that is not on the disk.
    pub text: Option<String>,
    /// The system file in place of the one that the sweep file names.
    pub system: Option<PathBuf>,
    /// The text of a system file that is not on the disk.
    pub system_text: Option<String>,
    /// The components that are functions.
    pub functions: Vec<(String, Signature)>,
    /// The changes of the system, of which the folder of the FMUs, the table of inputs and the sandbox count.
    pub overrides: Overrides,
}

impl SweepSource {
    /// The name of the sweep in messages.
    pub(super) fn name(&self) -> PathBuf {
        self.text.as_ref().map_or_else(|| self.file.clone(), |_| "sweep".into())
    }
}

/// The contents of a sweep file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SweepFile {
    /// The system file, relative to the folder of the sweep file.
    pub(super) system: PathBuf,
    /// Times and order that override the system's.
    pub(super) start: Option<f64>,
    pub(super) stop: Option<f64>,
    pub(super) step: Option<f64>,
    pub(super) order: Option<Order>,
    /// The saved state from which all runs begin, relative to the folder of the sweep file.
    pub(super) load_state: Option<PathBuf>,
    /// Start values of all runs, which override the system's.
    #[serde(default)]
    pub(super) set: BTreeMap<String, Literal>,
    #[serde(default)]
    pub(super) seed: u64,
    #[serde(default = "one")]
    pub(super) draws: u64,
    #[serde(default)]
    pub(super) parameter: Vec<Parameter>,
    pub(super) signals: SignalNames,
    #[serde(default)]
    pub(super) metrics: Criteria,
}

fn one() -> u64 {
    1
}

impl SweepFile {
    /// Reads a sweep; returns the text of its file, too.
    ///
    /// # Errors
    /// It cannot be read, or is no sweep file.
    pub(super) fn read(source: &SweepSource) -> Result<(Self, String)> {
        if source.text.is_none() && is_fmu(&source.file) {
            let text = format!(
                "{} is an FMU, expected a sweep file, or for a run ",
                source.file.display()
            );
            return Err(Advice::Simulate.after(text));
        }
        let text = source.text.clone().map_or_else(|| fs::read_to_string(&source.file), Ok);
        let text = text.with_context(|| format!("cannot read {}", source.file.display()));
        let text = text.map_err(|error| with_similar_file(error, &source.file))?;
        let file = toml::from_str(&text).map_err(|error| {
            let name = source.name();
            let shown = match (&source.text, error.span()) {
                // A field is missing from the whole text.
                (Some(_), Some(span))
                    if span.start == 0 && error.message().starts_with("missing") =>
                {
                    format!("{}: {}\n", name.display(), error.message())
                }
                (Some(text), Some(span)) => {
                    let line = text[..span.end].rsplit('\n').next().unwrap_or_default();
                    format!("{}: {line}: {}\n", name.display(), error.message())
                }
                _ => format!("{}: {error}", name.display()),
            };
            match error.message().contains("unknown field `component`") {
                true => Advice::Simulate.after(format!("{shown}it is a system, expected ")),
                false => anyhow!("{}", shown.trim_end()),
            }
        })?;
        Ok((file, text))
    }

    /// The changes of the description of the system: the signals are recorded, and options replace the system's.
    pub(super) fn overrides(&self, options: &Overrides) -> Overrides {
        Overrides {
            start: self.start,
            stop: self.stop,
            step: self.step,
            order: self.order,
            outputs: self.signals.to_record(),
            ..options.clone()
        }
    }
}
