//! What a container exposes of a system: the table `expose` of a system file.

use std::collections::BTreeMap;

use serde::Deserialize;

/// The variables that a container exposes, by their names in the system, `component.variable`.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expose {
    /// Inputs; by default all that neither a connection nor the input file feeds.
    pub inputs: Option<Vec<String>>,
    /// Outputs, and other variables to read; by default those that the system records.
    #[serde(default)]
    pub outputs: Vec<String>,
    /// Parameters; by default all.
    pub parameters: Option<Vec<String>>,
    /// Other names in the container.
    #[serde(default)]
    pub names: BTreeMap<String, String>,
}
