//! The libraries of a workspace that contain models, and the models in them.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use cargo_metadata::{CrateType, Metadata, MetadataCommand, Package};
use fmu_description::{ModelDescription, xml};

use crate::build::Build;

/// The feature that enables the program that prints a library's model descriptions.
const DESCRIBE: &str = "describe";

/// A package with a `cdylib` of models.
pub struct Library {
    /// Name of the package.
    pub package: String,
    /// Name of its library target.
    pub target: String,
    /// Folder of the package.
    pub folder: PathBuf,
    /// Name of the program that prints its model descriptions.
    pub describe: String,
}

/// A model with its description.
pub struct Model<'a> {
    /// Its library.
    pub library: &'a Library,
    /// Name of the model and of its binary.
    pub name: String,
    /// The GUID of its interface.
    pub guid: String,
    /// The text of its `modelDescription.xml`.
    pub xml: String,
}

/// The metadata of the workspace of the current folder.
pub fn metadata() -> Result<Metadata> {
    MetadataCommand::new()
        .exec()
        .context("cannot read the cargo workspace of the current folder")
}

/// The libraries of the workspace: packages with a `cdylib` that depend on `fmu-export` and have a
/// program that prints model descriptions.
pub fn libraries(metadata: &Metadata) -> Vec<Library> {
    metadata
        .workspace_packages()
        .into_iter()
        .filter_map(library)
        .collect()
}

fn library(package: &Package) -> Option<Library> {
    if !package.dependencies.iter().any(|d| d.name == "fmu-export") {
        return None;
    }
    let target = package
        .targets
        .iter()
        .find(|t| t.crate_types.contains(&CrateType::CDyLib))?;
    let describe = package
        .targets
        .iter()
        .find(|t| t.required_features.iter().any(|f| f == DESCRIBE))?;
    Some(Library {
        package: package.name.to_string(),
        target: target.name.clone(),
        folder: package.manifest_path.parent()?.into(),
        describe: describe.name.clone(),
    })
}

/// Builds and runs the programs that print the model descriptions of all libraries.
pub fn describe<'a>(libraries: &'a [Library], metadata: &Metadata) -> Result<Vec<Model<'a>>> {
    let mut build = Build::new("describing the models", "build");
    for library in libraries {
        build
            .args(["--package", &library.package, "--bin", &library.describe])
            .args(["--features", &format!("{}/{DESCRIBE}", library.package)]);
    }
    let artifacts = build.run(metadata.packages.len())?;
    let mut models = Vec::new();
    for library in libraries {
        let program = artifacts
            .executable(&library.describe)
            .with_context(|| format!("cargo built no program {}", library.describe))?;
        let output = Command::new(program)
            .output()
            .with_context(|| format!("cannot run {}", program.display()))?;
        ensure!(
            output.status.success(),
            "{} failed: {}",
            program.display(),
            String::from_utf8_lossy(&output.stderr)
        );
        let text = String::from_utf8(output.stdout)?;
        for xml in documents(&text) {
            let root = xml::parse(xml)?;
            let description = ModelDescription::read(&root)?;
            models.push(Model {
                library,
                name: description.name().to_owned(),
                guid: root.attribute("guid").unwrap_or_default().to_owned(),
                xml: xml.to_owned(),
            });
        }
    }
    check_names(&models)?;
    Ok(models)
}

/// The consecutive XML documents in a text.
fn documents(text: &str) -> impl Iterator<Item = &str> {
    const START: &str = "<?xml";
    let starts: Vec<usize> = text.match_indices(START).map(|(i, _)| i).collect();
    let ends = starts.clone().into_iter().skip(1).chain([text.len()]);
    starts.into_iter().zip(ends).map(|(a, b)| &text[a..b])
}

fn check_names(models: &[Model<'_>]) -> Result<()> {
    let mut names = BTreeSet::new();
    for model in models {
        let name = model.name.as_str();
        ensure!(
            name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
                && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'),
            "the model name {name:?} of {} is not a C identifier",
            model.library.package
        );
        ensure!(names.insert(name), "two models have the name {name}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_are_split_at_their_declarations() {
        let text = "<?xml version=\"1.0\"?><a/>\n<?xml version=\"1.0\"?><b/>\n";
        let all: Vec<_> = documents(text).collect();
        assert_eq!(
            all,
            [
                "<?xml version=\"1.0\"?><a/>\n",
                "<?xml version=\"1.0\"?><b/>\n"
            ]
        );
        assert_eq!(documents("").count(), 0);
    }
}
