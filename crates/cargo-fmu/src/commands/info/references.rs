//! What an FMU has by the layered standard FMI-LS-REF: parameter sets, experiments and related files.

use std::io::Write;

use anyhow::Result;
use fmu_file::archive::Archive;
use fmu_file::references::{Experiment, ParameterSet, References, RelatedFile};
use fmu_file::text::plain;
use serde_json::{Value, json};

use super::{MAX_DESCRIPTION, section};
use crate::ui;

/// Prints the sections of an FMU that has any.
pub fn print(archive: &mut Archive, out: &mut impl Write) -> Result<()> {
    let Some(References { files, parameter_sets, experiments, .. }) = References::read(archive)
    else {
        return Ok(());
    };
    let sets = parameter_sets.iter().map(|set| {
        let ParameterSet { name, description, parameters, .. } = set;
        let count = ui::count(parameters.len(), "parameter");
        line(name, &[description.clone(), count])
    });
    let experiments = experiments.iter().map(|experiment| {
        let Experiment { name, description, start, stop, step, tolerance, .. } = experiment;
        let times = [("start", start), ("stop", stop), ("step", step)];
        let times = times.iter().filter_map(|(key, time)| Some(format!("{key} {:?} s", (**time)?)));
        let tolerance = tolerance.map(|value| format!("tolerance {value:?}"));
        let sources = [
            ("parameters", &experiment.parameters),
            ("inputs", &experiment.stimuli),
            ("results", &experiment.references),
        ];
        let sources = sources.into_iter().filter_map(|(key, source)| {
            let file = source.as_ref()?.file.rsplit('/').next();
            Some(format!("{key} {}", file.unwrap_or_default()))
        });
        let other = experiment.other_analysis.clone();
        let parts = [description.clone()].into_iter().chain(other).chain(times);
        line(name, &Vec::from_iter(parts.chain(tolerance).chain(sources)))
    });
    let related = files.iter().map(|related| {
        let RelatedFile { file, role, description, .. } = related;
        line(file, &[role.clone(), description.clone()])
    });
    section("parameter sets", &Vec::from_iter(sets), out)?;
    section("experiments", &Vec::from_iter(experiments), out)?;
    section("related files", &Vec::from_iter(related), out)
}

/// A line with a name and what is known of it.
fn line(name: &str, parts: &[String]) -> String {
    let parts = parts.iter().map(String::as_str).filter(|part| !part.is_empty());
    let text = format!("{name}: {}", Vec::from_iter(parts).join(", "));
    ui::filled(&format!("  {}", plain(&text, MAX_DESCRIPTION)), ui::width(), "    ")
}

/// The same as JSON; null if the FMU has none.
pub fn json(archive: &mut Archive) -> Value {
    let Some(References { files, parameter_sets, experiments, .. }) = References::read(archive)
    else {
        return Value::Null;
    };
    let sets = parameter_sets.iter().map(|set| {
        let ParameterSet { name, description, file, parameters } = set;
        json!({ "name": name, "description": description, "file": file, "parameters": parameters })
    });
    let experiments = experiments.iter().map(|experiment| {
        let file = |source: &Option<fmu_file::references::Source>| {
            source.as_ref().map(|source| source.file.clone())
        };
        json!({
            "name": experiment.name,
            "description": experiment.description,
            "analysis": experiment.other_analysis,
            "startTime": experiment.start,
            "stopTime": experiment.stop,
            "stepSize": experiment.step,
            "tolerance": experiment.tolerance,
            "parameters": file(&experiment.parameters),
            "stimuli": file(&experiment.stimuli),
            "references": file(&experiment.references),
        })
    });
    let files = files.iter().map(|related| {
        let RelatedFile { file, of_type, role, description, .. } = related;
        json!({ "file": file, "type": of_type, "role": role, "description": description })
    });
    json!({
        "parameterSets": Vec::from_iter(sets),
        "experiments": Vec::from_iter(experiments),
        "relatedFiles": Vec::from_iter(files),
    })
}
