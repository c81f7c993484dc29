//! The files of a model in the package's folder `references/<MODEL>/`: parameter sets, experiments and results, which
//! its FMU has by the layered standard FMI-LS-REF.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::{self, Element};
use fmu_file::references::{
    ATTRIBUTES, EXPERIMENTS, EXPERIMENTS_ROOT, FOLDER, MANIFEST, MANIFEST_ROOT, NAMESPACE,
    PARAMETER_SET, SIMULATION, TABLE,
};
use serde::Deserialize;

use crate::library::{NamedFile, read};

/// Describes the experiments; the FMU has them in the format of the standard.
const OWN_EXPERIMENTS: &str = "experiments.toml";
const STANDARD_EXPERIMENTS: &str = "experiments.exp";

/// The types and roles of files by their endings; others have the role `other`.
const KINDS: [(&str, &str, &str); 9] = [
    ("ssv", PARAMETER_SET, "parameter"),
    ("exp", EXPERIMENTS, "experiment"),
    ("csv", TABLE, "result"),
    ("md", "text/markdown", "document"),
    ("txt", "text/plain", "document"),
    ("html", "text/html", "document"),
    ("pdf", "application/pdf", "document"),
    ("mo", "text/modelica", "model"),
    ("ssd", "application/x-ssp-definition", "system"),
];

/// The content of `experiments.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Experiments {
    experiment: Vec<Experiment>,
}

/// An experiment, with times in s; files are in the same folder.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Experiment {
    name: String,
    description: Option<String>,
    start: Option<f64>,
    stop: Option<f64>,
    step: Option<f64>,
    tolerance: Option<f64>,
    parameters: Option<String>,
    input: Option<String>,
    results: Option<String>,
}

/// The files of a model, with the manifest; empty if there is no folder.
///
/// # Errors
/// A file cannot be used, or the folder has no file that an experiment names.
pub fn files(package: &Path, model: &str) -> Result<Vec<NamedFile>> {
    let folder = package.join("references").join(model);
    let own =
        read(&folder).and_then(with_manifest).with_context(|| folder.display().to_string())?;
    Ok(own.into_iter().map(|(name, content)| (format!("{FOLDER}/{name}"), content)).collect())
}

fn with_manifest(mut files: Vec<NamedFile>) -> Result<Vec<NamedFile>> {
    let manifest = MANIFEST.rsplit('/').next().unwrap_or_default();
    if files.is_empty() || files.iter().any(|(name, _)| name == manifest) {
        return Ok(files);
    }
    let mut uses = HashMap::new();
    if let Some(index) = files.iter().position(|(name, _)| name == OWN_EXPERIMENTS) {
        let (_, content) = files.remove(index);
        let document = experiments(&content, &files, &mut uses).context(OWN_EXPERIMENTS)?;
        let is_taken = files.iter().any(|(name, _)| name == STANDARD_EXPERIMENTS);
        ensure!(
            !is_taken,
            "{STANDARD_EXPERIMENTS} is made of {OWN_EXPERIMENTS}; expected one of them"
        );
        files.push((STANDARD_EXPERIMENTS.to_owned(), document.into_bytes()));
        files.sort();
    }
    let mut root = Element::new(MANIFEST_ROOT).with("xmlns:fmi-ls", NAMESPACE);
    for (name, value) in ATTRIBUTES {
        let name = match name {
            "fmi-ls-name" => "fmi-ls:fmi-ls-name",
            "fmi-ls-version" => "fmi-ls:fmi-ls-version",
            _ => "fmi-ls:fmi-ls-description",
        };
        root = root.with(name, value);
    }
    for (name, content) in &files {
        root = root.holding_all(related(name, content, &uses)?);
    }
    files.push((manifest.to_owned(), root.document()?.into_bytes()));
    Ok(files)
}

/// What an experiment uses a table for: its inputs, or its results, with the name of the experiment.
enum Use {
    Input,
    Results(String),
}

/// The entry of a file in the manifest; tables of inputs have none, as their experiments name them.
fn related(
    name: &str,
    content: &[u8],
    uses: &HashMap<String, Use>,
) -> Result<Option<Element<'static>>> {
    let ending = name.rsplit_once('.').map_or("", |(_, ending)| ending).to_lowercase();
    let kind = KINDS.iter().find(|(known, ..)| *known == ending);
    let (_, of_type, role) = kind.unwrap_or(&("", "application/octet-stream", "other"));
    let description = match (*role, uses.get(name)) {
        (_, Some(Use::Input)) => return Ok(None),
        (_, Some(Use::Results(experiment))) => {
            Some(format!("Results of the experiment {experiment}"))
        }
        ("parameter" | "experiment", None) => {
            let text = str::from_utf8(content).with_context(|| format!("{name} is not UTF-8"))?;
            let root = xml::parse(text).with_context(|| name.to_owned())?;
            let attribute = |name| root.attribute(name).filter(|text| !text.is_empty());
            attribute("description").or(attribute("name")).map(str::to_owned)
        }
        _ => None,
    };
    // Characters that have a meaning in addresses.
    let source =
        name.replace('%', "%25").replace(' ', "%20").replace('#', "%23").replace('?', "%3F");
    let element = Element::new("Related").with("type", of_type).with("source", source);
    Ok(Some(element.with("role", role).with_some("description", description)))
}

/// The experiments in the format of the standard.
fn experiments(
    content: &[u8],
    files: &[NamedFile],
    uses: &mut HashMap<String, Use>,
) -> Result<String> {
    let text = str::from_utf8(content).context("it is not UTF-8")?;
    let Experiments { experiment: experiments } = toml::from_str(text)
        .map_err(|error| anyhow::anyhow!("{}", error.to_string().trim_end()))?;
    ensure!(!experiments.is_empty(), "there is no experiment, expected at least one");
    let mut root = Element::new(EXPERIMENTS_ROOT).with("name", "Experiments");
    let mut names = Vec::new();
    for own in experiments {
        let name = own.name;
        ensure!(!names.contains(&name), "two experiments have the name {name:?}");
        let numbers = [own.start, own.stop, own.step, own.tolerance];
        let is_finite = numbers.iter().flatten().all(|number| number.is_finite());
        ensure!(is_finite, "a number of the experiment {name:?} is not finite");
        let source = |file: &String| {
            if !files.iter().any(|(known, _)| known == file) {
                bail!("the experiment {name:?} uses {file}, which is not in the folder");
            }
            Ok(file.clone())
        };
        let mut parts = Vec::new();
        let given = [
            ("Parameters", &own.parameters, None),
            ("Stimuli", &own.input, Some(Use::Input)),
            ("References", &own.results, Some(Use::Results(name.clone()))),
        ];
        for (part, file, use_of) in given {
            if let Some(file) = file {
                parts.push(Element::new(part).with("source", source(file)?));
                uses.extend(use_of.map(|use_of| (file.clone(), use_of)));
            }
        }
        let number = |number: Option<f64>| number.map(|number| format!("{number:?}"));
        let simulation = Element::new(SIMULATION)
            .with_some("startTime", number(own.start))
            .with_some("stopTime", number(own.stop))
            .with_some("stepSize", number(own.step));
        let element = Element::new("Experiment")
            .with("name", &name)
            .with_some("description", own.description)
            .with_some("tolerance", number(own.tolerance));
        root = root.holding(element.holding(simulation).holding_all(parts));
        names.push(name);
    }
    root.document()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn made(files: &[(&str, &str)]) -> Result<HashMap<String, String>> {
        let files = files.iter().map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec()));
        let made = with_manifest(files.collect())?.into_iter();
        Ok(made.map(|(name, text)| (name, String::from_utf8(text).unwrap())).collect())
    }

    #[test]
    fn experiments_and_files_are_listed_as_the_standard_says() {
        let toml = "[[experiment]]\nname = 'fall'\nstop = 2\nstep = 1e-3\ntolerance = 0.001\n\
            parameters = 'soft.ssv'\ninput = 'in.csv'\nresults = 'out.csv'\n";
        let files = [
            ("experiments.toml", toml),
            ("in.csv", "time,u\n0,1\n"),
            ("notes of it.md", ""),
            ("out.csv", "time,y\n0,1\n"),
            ("soft.ssv", "<ssv:ParameterSet name='soft' description='a soft spring'/>"),
        ];
        let made = made(&files).unwrap();
        let expected = r#"<?xml version="1.0" encoding="UTF-8"?>
<Experiments name="Experiments">
  <Experiment name="fall" tolerance="0.001">
    <TransientSimulation stopTime="2.0" stepSize="0.001"/>
    <Parameters source="soft.ssv"/>
    <Stimuli source="in.csv"/>
    <References source="out.csv"/>
  </Experiment>
</Experiments>
"#;
        assert_eq!(made["experiments.exp"], expected);
        let manifest = &made["fmi-ls-manifest.xml"];
        let lines = Vec::from_iter(manifest.lines().skip(2).map(str::trim));
        let related = |rest: &str| format!("<Related type={rest}/>");
        let expected = [
            related(
                r#""application/x-ma-hs-experiments" source="experiments.exp" role="experiment" description="Experiments""#,
            ),
            related(r#""text/markdown" source="notes%20of%20it.md" role="document""#),
            related(
                r#""text/csv" source="out.csv" role="result" description="Results of the experiment fall""#,
            ),
            related(
                r#""application/x-ssp-parameter-set" source="soft.ssv" role="parameter" description="a soft spring""#,
            ),
        ];
        assert_eq!(lines[..4], expected.each_ref().map(String::as_str));
        assert!(!made.contains_key("experiments.toml"));
    }

    #[test]
    fn a_manifest_of_the_author_stays_and_mistakes_are_named() {
        let own = [("fmi-ls-manifest.xml", "<own/>"), ("a.csv", "")];
        assert_eq!(made(&own).unwrap()["fmi-ls-manifest.xml"], "<own/>");
        assert!(made(&[]).unwrap().is_empty());
        let experiment = |keys: &str| format!("[[experiment]]\nname = 'a'\n{keys}");
        for (text, reason) in [
            (
                experiment("input = 'b.csv'"),
                "the experiment \"a\" uses b.csv, which is not in the folder",
            ),
            (experiment("stop = inf"), "is not finite"),
            (experiment("end = 1"), "unknown field `end`"),
            (experiment("[[experiment]]\nname = 'a'"), "two experiments have the name \"a\""),
            ("experiment = []".to_owned(), "there is no experiment"),
        ] {
            let error = made(&[("experiments.toml", &text)]).unwrap_err();
            assert!(format!("{error:#}").contains(reason), "{error:#}");
        }
        assert!(made(&[("a.ssv", "no XML")]).is_err());
    }
}
