//! What is observed of the calls of a run, as the user asks for.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Result;
use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::observers::Observers;
use crate::profile::Profiler;
use crate::trace::Recorder;
use crate::{LoadedComponent, Messages};

/// What is observed of the calls of a run; by default nothing, which costs nothing.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, Args)]
pub struct Observation {
    /// Record each call of the FMUs with arguments, results and duration in this file, as JSON Lines; `cargo fmu replay`
    /// repeats them
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Whether to measure the time of each component and function.
    #[arg(skip)]
    pub profile: bool,
}

impl Observation {
    /// The messages of a simulation, whose calls are observed from now on. Creates the file of the trace.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn begin(&self, messages: Messages, components: &[LoadedComponent]) -> Result<Messages> {
        let lines = || Vec::from_iter(components.iter().map(of_component));
        let create = |file: &PathBuf| Recorder::create(file, &lines()).map(Arc::new);
        let names = components.iter().map(|component| component.name.clone());
        Ok(messages.observed_by(Observers {
            recorder: self.trace.as_ref().map(create).transpose()?,
            profiler: self.profile.then(|| Profiler::new(names.clone()).into()),
            components: names.collect(),
        }))
    }
}

/// The line of a component in a trace.
fn of_component(component: &LoadedComponent) -> Vec<(&'static str, Value)> {
    let LoadedComponent { name, fmu, .. } = component;
    let variables = fmu.variables.iter().map(|variable| {
        let of_type = variable.of_type.as_str();
        match variable.element_count() {
            1 => json!([variable.name, of_type, variable.reference]),
            elements => json!([variable.name, of_type, variable.reference, elements]),
        }
    });
    let variables = ("variables", Vec::from_iter(variables).into());
    let name = ("component", Value::from(name.as_str()));
    let Some(binary) = fmu.binary() else { return vec![name, variables] };
    let file = std::path::absolute(&fmu.path).unwrap_or_else(|_| fmu.path.clone());
    let interface = fmu.interface_type.option_name();
    vec![
        name,
        ("fmu", file.to_string_lossy().into()),
        ("binary", binary.file.as_str().into()),
        ("fmi", fmu.version.as_str().into()),
        ("interface", interface.into()),
        ("token", binary.token.as_str().into()),
        variables,
    ]
}
