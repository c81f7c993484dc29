//! Checks of the archive and of the files that it must contain.

use std::collections::{BTreeSet, HashSet};

use fmu_description::ModelDescription;
use fmu_file::archive::Archive;
use fmu_file::platform::{self, Platform};
use fmu_file::text::quote;

use super::finding::Findings;

/// The elements of the two interface types.
pub const KINDS: [&str; 2] = ["ModelExchange", "CoSimulation"];

/// Checks that the archive can be unpacked.
pub fn check(archive: &mut Archive, findings: &mut Findings) {
    for fault in &archive.faults {
        findings.error("archive", fault);
    }
    // Files that are too large must not be inflated.
    if archive.faults.is_empty() {
        for damage in archive.damages() {
            findings.error("archive", damage);
        }
    }
}

/// Checks that each interface type has its sources, or its binary for each platform.
pub fn check_binaries(
    model: &ModelDescription<'_>,
    archive: &mut Archive,
    findings: &mut Findings,
) {
    sources(model, archive, findings);
    let folders: BTreeSet<String> = platform::folders(&archive.names)
        .into_iter()
        .map(str::to_owned)
        .collect();
    if folders.is_empty()
        && !model
            .root
            .children
            .iter()
            .any(|kind| kind.child("SourceFiles").is_some())
    {
        findings.error(
            "archive",
            "it has neither binaries nor sources, expected at least one of the two",
        );
    }
    for folder in folders {
        match folder.parse::<Platform>() {
            Ok(platform) => binaries(model, platform, archive, findings),
            Err(error) => findings.warning(format!("binaries/{folder}"), error.to_string()),
        }
    }
}

fn binaries(
    model: &ModelDescription<'_>,
    platform: Platform,
    archive: &mut Archive,
    findings: &mut Findings,
) {
    let kinds = model
        .root
        .children
        .iter()
        .filter(|child| KINDS.contains(&child.name));
    let files: BTreeSet<String> = kinds
        .filter_map(|kind| kind.attribute("modelIdentifier"))
        .map(|identifier| platform.binary(identifier))
        .collect();
    for file in files {
        if !archive.names.contains(&file) {
            findings.error(
                format!("binaries/{}", platform.folder),
                format!(
                    "it has no {}, expected the binary that modelIdentifier names",
                    quote(&file)
                ),
            );
            continue;
        }
        let checked = archive
            .head(&file, Platform::HEAD)
            .and_then(|head| platform.check(&head));
        if let Err(error) = checked {
            findings.error(file, format!("{error:#}"));
        }
    }
}

/// Checks that the listed source files exist.
fn sources(model: &ModelDescription<'_>, archive: &Archive, findings: &mut Findings) {
    let kinds = model
        .root
        .children
        .iter()
        .filter(|child| KINDS.contains(&child.name));
    let names: HashSet<&str> = archive.names.iter().map(String::as_str).collect();
    for file in kinds.flat_map(|kind| kind.list("SourceFiles", "File")) {
        if let Some(name) = file.attribute("name")
            && !names.contains(format!("sources/{name}").as_str())
        {
            findings.error(
                file,
                format!(
                    "the source file {} is missing, expected it in sources",
                    quote(name)
                ),
            );
        }
    }
}
