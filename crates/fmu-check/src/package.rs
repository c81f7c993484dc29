//! Checks of the archive and of the files that it must contain.

use std::collections::{BTreeSet, HashSet};

use fmu_description::ModelDescription;
use fmu_file::archive::{self, Archive};
use fmu_file::platform::{self, Platform};
use fmu_file::text::quote;

use super::finding::Findings;
use super::rule::rules;

rules! {
    /// What the archive must contain.
    pub ARCHIVE {
        FILE: Error, "file", Practice("nothing else can be checked"),
            "The FMU is a file that can be read.";
        READABLE: Error, "archive-readable", Standard("section 2.3"),
            "The FMU is a zip archive with a well-formed modelDescription.xml at its root.";
        SAFE_ARCHIVE: Error, "archive-safe",
            Practice("importers refuse to unpack what may harm the computer"),
            "The archive can be unpacked without risk to other files, the memory and the disk.";
        PLAIN_ARCHIVE: Error, "archive-plain",
            Practice("the zip format demands it, and importers such as FMPy refuse some such archives"),
            "Names are unique relative paths with forward slashes, and all entries are files or folders.";
        UTF_8: Error, "utf-8", Standard("section 2.2"),
            "modelDescription.xml is encoded in UTF-8.";
        INTACT_FILES: Error, "files-intact", Standard("section 2.3"),
            "Every file of the archive can be unpacked.";
        BINARIES_OR_SOURCES: Error, "binaries-or-sources", Standard("section 2.3"),
            "There are binaries or sources.";
        KNOWN_PLATFORM: Warning, "platform-known",
            Practice("importers look for binaries only in the platform folders of section 2.3"),
            "The folders in binaries are those of the standard.";
        BINARY_NAMED: Error, "binary-named", Standard("section 2.3"),
            "Each platform folder has the binary that modelIdentifier names.";
        BINARY_FORMAT: Error, "binary-format", Standard("section 2.3"),
            "A binary is a shared library of its platform.";
        SOURCES_EXIST: Error, "sources-exist", Standard("section 2.3"),
            "The files that SourceFiles lists are in the folder sources.";
        SOURCES_UNIQUE: Error, "sources-unique", Standard("sections 3.3.1 and 4.3.1"),
            "SourceFiles lists each file once.";
    }
}

/// The elements of the two interface types.
pub const KINDS: [&str; 2] = ["ModelExchange", "CoSimulation"];

/// Checks that the archive can be unpacked.
pub fn check(archive: &mut Archive, findings: &mut Findings) {
    for fault in &archive.faults {
        findings.add(&SAFE_ARCHIVE, "archive", fault);
    }
    for oddity in &archive.oddities {
        findings.add(&PLAIN_ARCHIVE, "archive", oddity);
    }
    // Files that are too large must not be inflated.
    if archive.faults.is_empty() {
        for damage in archive.damages() {
            findings.add(&INTACT_FILES, "archive", damage);
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
        findings.add(
            &BINARIES_OR_SOURCES,
            "archive",
            "it has neither binaries nor sources, expected at least one of the two",
        );
    }
    for folder in folders {
        match folder.parse::<Platform>() {
            Ok(platform) => binaries(model, platform, archive, findings),
            Err(error) => findings.add(
                &KNOWN_PLATFORM,
                format!("binaries/{folder}"),
                error.to_string(),
            ),
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
            findings.add(
                &BINARY_NAMED,
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
            findings.add(&BINARY_FORMAT, file, format!("{error:#}"));
        }
    }
}

/// Checks that the listed source files exist, and that each is listed once.
fn sources(model: &ModelDescription<'_>, archive: &Archive, findings: &mut Findings) {
    let names: HashSet<&str> = archive.names.iter().map(String::as_str).collect();
    for kind in KINDS {
        let mut listed = HashSet::new();
        for file in model
            .root
            .children(kind)
            .flat_map(|kind| kind.list("SourceFiles", "File"))
        {
            let Some(name) = file.attribute("name") else {
                continue;
            };
            let path = archive::relative(&format!("sources/{name}"));
            if !path
                .as_ref()
                .is_ok_and(|path| names.contains(path.as_str()))
            {
                let name = quote(name);
                let text = format!("the source file {name} is missing, expected it in sources");
                findings.add(&SOURCES_EXIST, file, text);
            }
            if !listed.insert(path.unwrap_or_else(|_| name.to_owned())) {
                let text = format!(
                    "the source file {} is listed twice, expected once",
                    quote(name)
                );
                findings.add(&SOURCES_UNIQUE, file, text);
            }
        }
    }
}
