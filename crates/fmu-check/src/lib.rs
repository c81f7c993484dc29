//! Checks FMUs from any vendor as an importer would: the archive, the model description against the
//! schema and the rules of the standard, and the binaries by running them.
//!
//! A binary may crash, hang or exit, so each test of it runs in a child process: [`Probes`] defines the
//! program to start, which passes its arguments to [`probe`].
#![forbid(unsafe_code)]

mod binary;
mod build;
mod exports;
mod finding;
pub mod format;
mod package;
mod rule;
mod rules;
mod schema;
mod terminals;

use std::path::Path;

pub use binary::Probes;
pub use binary::child::run as probe;
pub use finding::{Finding, Findings, Group, Location, Severity};
use fmu_description::xml::{self, Element};
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
pub use rule::{Rule, Source};
use schema::Schema;

/// All rules, by the part of the FMU that they are about.
pub fn rules() -> impl Iterator<Item = &'static Rule> {
    [
        package::ARCHIVE,
        exports::EXPORTS,
        build::BUILD,
        terminals::TERMINALS,
        schema::SCHEMA,
        rules::root::ROOT,
        rules::DEFINITIONS,
        rules::units::UNITS,
        rules::types::TYPES,
        rules::names::NAMES,
        rules::variables::VARIABLES,
        rules::structure::STRUCTURE,
        rules::arrays::ARRAYS,
        rules::clocks::CLOCKS,
        binary::rules::BEHAVIOUR,
    ]
    .into_iter()
    .flatten()
}

/// Checks an FMU and adds what it finds; its binaries are run only if `probes` is given.
pub fn check(file: &Path, probes: Option<&Probes>, findings: &mut Findings) {
    let mut archive = match Archive::open(file) {
        Ok(archive) => archive,
        Err(error) => {
            let rule = match file.is_file() {
                true => &package::READABLE,
                false => &package::FILE,
            };
            return findings.add(rule, "archive", format!("{error:#}"));
        }
    };
    let decoded = match archive.model_description_bytes() {
        Ok(bytes) => xml::decode(&bytes),
        Err(error) => {
            package::check(&mut archive, findings);
            return findings.add(&package::READABLE, "archive", format!("{error:#}"));
        }
    };
    let parsed = xml::parse(&decoded.text);
    let version = parsed.as_ref().map_or(Some(FmiVersion::Fmi2), version);
    findings.set_version(version.unwrap_or(FmiVersion::Fmi2));
    package::check(&mut archive, findings);
    let root = match parsed {
        Ok(root) => root,
        Err(error) => {
            return findings.add(&package::READABLE, MODEL_DESCRIPTION, format!("{error:#}"));
        }
    };
    let Some(version) = version else {
        // The rules of another version are different.
        let text = ModelDescription::other_version(&root).unwrap_or_default();
        return findings.add(&rules::root::FMI_VERSION, &root, text);
    };
    for fault in decoded.faults {
        findings.add(&package::UTF_8, MODEL_DESCRIPTION, fault);
    }
    schema::check(
        MODEL_DESCRIPTION,
        &root,
        &Schema::of_model(version),
        findings,
    );
    let model = ModelDescription::new(&root);
    rules::check(&root, findings);
    package::check_binaries(&root, &mut archive, findings);
    if version == FmiVersion::Fmi3 {
        package::check_folders(&archive, findings);
        terminals::check(&root, &mut archive, findings);
    }
    if let Some(probes) = probes
        && archive.faults.is_empty()
    {
        binary::check(&decoded.text, &model, &mut archive, probes, findings);
    }
}

/// The version that the root of a model description gives, by default FMI 2.0; `None` if it is another
/// one.
fn version(root: &Element<'_>) -> Option<FmiVersion> {
    match root.attribute("fmiVersion") {
        None | Some("2.0") => Some(FmiVersion::Fmi2),
        _ if root.name != "fmiModelDescription" => Some(FmiVersion::Fmi2),
        Some(version) => version.starts_with("3.").then_some(FmiVersion::Fmi3),
    }
}
