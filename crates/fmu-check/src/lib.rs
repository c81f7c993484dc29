//! Checks FMUs from any vendor as an importer would: the archive, the model description against the
//! schema and the rules of the standard, and the binaries by running them.
//!
//! A binary may crash, hang or exit, so each test of it runs in a child process: [`Probes`] defines the
//! program to start, which passes its arguments to [`probe`].
#![forbid(unsafe_code)]

mod binary;
mod finding;
pub mod format;
mod package;
mod rule;
mod rules;
mod schema;

use std::path::Path;

pub use binary::Probes;
pub use binary::child::run as probe;
pub use finding::{Finding, Findings, Group, Location, Severity};
use fmu_description::ModelDescription;
use fmu_description::xml;
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
pub use rule::{Rule, Source};

/// All rules, by the part of the FMU that they are about.
pub fn rules() -> impl Iterator<Item = &'static Rule> {
    [
        package::ARCHIVE,
        schema::SCHEMA,
        rules::root::ROOT,
        rules::DEFINITIONS,
        rules::units::UNITS,
        rules::types::TYPES,
        rules::names::NAMES,
        rules::variables::VARIABLES,
        rules::structure::STRUCTURE,
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
    package::check(&mut archive, findings);
    let bytes = match archive.model_description_bytes() {
        Ok(bytes) => bytes,
        Err(error) => {
            return findings.add(&package::READABLE, "archive", format!("{error:#}"));
        }
    };
    let decoded = xml::decode(&bytes);
    let root = match xml::parse(&decoded.text) {
        Ok(root) => root,
        Err(error) => {
            return findings.add(&package::READABLE, MODEL_DESCRIPTION, format!("{error:#}"));
        }
    };
    if let Some(version) = ModelDescription::other_version(&root) {
        // The rules of another version are different.
        return findings.add(&rules::root::FMI_VERSION, &root, version);
    }
    for fault in decoded.faults {
        findings.add(&package::UTF_8, MODEL_DESCRIPTION, fault);
    }
    schema::check(&root, findings);
    let model = ModelDescription::new(&root);
    rules::check(&model, findings);
    package::check_binaries(&model, &mut archive, findings);
    if let Some(probes) = probes
        && archive.faults.is_empty()
    {
        binary::check(&decoded.text, &model, &mut archive, probes, findings);
    }
}
