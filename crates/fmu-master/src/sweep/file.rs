//! The contents of a sweep file (docs/sweeps.md).

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use serde::Deserialize;

use super::metrics::Criteria;
use super::parameter::Parameter;
use super::signals::SignalNames;
use crate::{Advice, Literal, Order, Overrides};

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
    /// Reads a sweep file; returns its text, too.
    ///
    /// # Errors
    /// It cannot be read, or is no sweep file.
    pub(super) fn read(path: &Path) -> Result<(Self, String)> {
        let text =
            fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        let file = toml::from_str(&text).map_err(|error| {
            let text = format!("{}: {error}", path.display());
            match error.message().contains("unknown field `component`") {
                true => Advice::Simulate.after(format!("{text}it is a system, expected ")),
                false => anyhow!("{text}"),
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
