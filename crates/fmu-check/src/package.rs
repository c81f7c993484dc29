//! Checks of the archive and of the files that it must contain.

use std::collections::{BTreeSet, HashSet};

use fmu_description::FmiVersion;
use fmu_description::xml::{self, Element};
use fmu_file::archive::{self, Archive};
use fmu_file::platform::{self, Platform};
use fmu_file::text::quote;

use super::finding::Findings;
use super::rule::rules;
use crate::{build, exports};

rules! {
    /// What the archive must contain.
    pub ARCHIVE {
        FILE: Error, "file", Practice("nothing else can be checked"),
            "The FMU is a file that can be read.";
        READABLE: Error, "archive-readable", Standard("section 2.3", "section 2.5"),
            "The FMU is a zip archive with a well-formed modelDescription.xml at its root.";
        SAFE_ARCHIVE: Error, "archive-safe",
            Practice("importers refuse to unpack what may harm the computer"),
            "The archive can be unpacked without risk to other files, the memory and the disk.";
        PLAIN_ARCHIVE: Error, "archive-plain",
            Practice("the zip format demands it, and importers such as FMPy refuse some such archives"),
            "Names are unique relative paths with forward slashes, and all entries are files or folders.";
        UTF_8: Error, "utf-8", Standard("section 2.2", "section 2.4"),
            "XML files are encoded in UTF-8.";
        INTACT_FILES: Error, "files-intact", Standard("section 2.3", "section 2.5"),
            "Every file of the archive can be unpacked.";
        BINARIES_OR_SOURCES: Error, "binaries-or-sources", Standard("section 2.3", "section 2.5"),
            "There are binaries or sources.";
        KNOWN_PLATFORM: Warning, "platform-known",
            Practice("importers look for binaries only in the platform folders of the standard"),
            "The folders in binaries are those of the standard.";
        BINARY_NAMED: Error, "binary-named", Standard("section 2.3", "section 2.5.1.4"),
            "Each platform folder has the binary that modelIdentifier names.";
        BINARY_FORMAT: Error, "binary-format", Standard("section 2.3", "section 2.5.1.4"),
            "A binary is a shared library of its platform.";
        SOURCES_EXIST: Error, "sources-exist", Standard("section 2.3", "section 2.4.10"),
            "The source files that are listed are in the folder sources.";
        SOURCES_UNIQUE: Error, "sources-unique", Fmi2("sections 3.3.1 and 4.3.1"),
            "SourceFiles lists each file once.";
        IMAGE_PNG: Error, "image-png", Fmi3("section 2.5.1"),
            "diagram.svg and icon.svg have a PNG file of the same name beside them.";
        LICENCE_ENTRY: Error, "licence-entry", Fmi3("section 2.5.1.1.1"),
            "The folder of licences has a file license.txt, license.html or license.spdx.";
        STATIC_LINKING: Error, "static-linking", Fmi3("section 2.5.1.4.1"),
            "An FMU with a static library has documentation/staticLinking.txt or .html.";
        EXTRA_DOMAIN: Warning, "extra-domain", Fmi3("section 2.5.1.6"),
            "The folder extra has subfolders that are named after domains.";
    }
}

/// Names of the interface types.
pub const INTERFACES: [&str; 3] = ["ModelExchange", "CoSimulation", "ScheduledExecution"];

/// Maximum number of bytes that are read of an XML file.
const MAX_XML: u64 = 64 << 20;

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
pub fn check_binaries(root: &Element<'_>, archive: &mut Archive, findings: &mut Findings) {
    let folders: BTreeSet<String> = platform::folders(&archive.names)
        .into_iter()
        .map(str::to_owned)
        .collect();
    let has_sources = match findings.version() {
        FmiVersion::Fmi2 => {
            sources(root, archive, findings);
            interfaces(root).any(|interface| interface.child("SourceFiles").is_some())
        }
        FmiVersion::Fmi3 => {
            build::check(root, archive, findings);
            archive.names.iter().any(|name| name == build::FILE)
        }
    };
    if folders.is_empty() && !has_sources {
        findings.add(
            &BINARIES_OR_SOURCES,
            "archive",
            "it has neither binaries nor sources, expected at least one of the two",
        );
    }
    for folder in folders {
        match Platform::named(&folder, findings.version()) {
            Ok(platform) => binaries(root, platform, archive, findings),
            Err(_) if findings.version() == FmiVersion::Fmi3 && is_static(&folder) => {}
            Err(error) => findings.add(
                &KNOWN_PLATFORM,
                format!("binaries/{folder}"),
                error.to_string(),
            ),
        }
    }
}

/// The elements of the interface types.
pub fn interfaces<'a, 'b>(root: &'a Element<'b>) -> impl Iterator<Item = &'a Element<'b>> {
    root.children
        .iter()
        .filter(|child| INTERFACES.contains(&child.name))
}

/// Whether a folder is for static libraries: a platform of FMI 3.0 and an ABI.
fn is_static(folder: &str) -> bool {
    let abi = folder.match_indices('-').nth(1);
    abi.is_some_and(|(end, _)| Platform::named(&folder[..end], FmiVersion::Fmi3).is_ok())
}

fn binaries(
    root: &Element<'_>,
    platform: Platform,
    archive: &mut Archive,
    findings: &mut Findings,
) {
    let identifiers: BTreeSet<&str> = interfaces(root)
        .filter_map(|interface| interface.attribute("modelIdentifier"))
        .collect();
    for identifier in identifiers {
        let file = platform.binary(identifier);
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
        match checked {
            Err(error) => findings.add(&BINARY_FORMAT, file, format!("{error:#}")),
            Ok(()) if findings.version() == FmiVersion::Fmi3 => {
                exports::check(&file, identifier, root, archive, findings);
            }
            Ok(()) => {}
        }
    }
}

/// Reads an XML file; `None` if there is none. Damage is reported by [`check`].
pub fn xml(name: &str, archive: &mut Archive, findings: &mut Findings) -> Option<String> {
    let bytes = archive.head(name, MAX_XML).ok()?;
    let decoded = xml::decode(&bytes);
    for fault in decoded.faults {
        findings.add(&UTF_8, name, fault);
    }
    Some(decoded.text)
}

/// Checks the folders of documentation, icons and further data (FMI 3.0.2, section 2.5.1).
pub fn check_folders(archive: &Archive, findings: &mut Findings) {
    let names: HashSet<&str> = archive.names.iter().map(String::as_str).collect();
    for image in ["documentation/diagram", "terminalsAndIcons/icon"] {
        let (vector, pixels) = (format!("{image}.svg"), format!("{image}.png"));
        if names.contains(vector.as_str()) && !names.contains(pixels.as_str()) {
            let text = format!("it has no {pixels} beside it, expected both");
            findings.add(&IMAGE_PNG, vector, text);
        }
    }
    const LICENCES: &str = "documentation/licenses/";
    let is_file_in = |folder| move |name: &&&str| name.starts_with(folder) && !name.ends_with('/');
    if names.iter().any(|name| is_file_in(LICENCES)(&name))
        && !["spdx", "txt", "html"]
            .iter()
            .any(|extension| names.contains(format!("{LICENCES}license.{extension}").as_str()))
    {
        let text = "it has no license.txt, license.html or license.spdx, expected one of them";
        findings.add(&LICENCE_ENTRY, LICENCES, text);
    }
    for folder in platform::folders(&archive.names) {
        if is_static(folder)
            && !["txt", "html"].iter().any(|extension| {
                names.contains(format!("documentation/staticLinking.{extension}").as_str())
            })
        {
            let text =
                "it holds a static library, expected documentation/staticLinking.txt or .html";
            findings.add(&STATIC_LINKING, format!("binaries/{folder}"), text);
        }
    }
    let folders: BTreeSet<&str> = (names.iter())
        .filter(is_file_in("extra/"))
        .filter_map(|name| name.split('/').nth(1))
        .collect();
    for folder in folders.into_iter().filter(|folder| !folder.contains('.')) {
        let text = format!(
            "it is {}, expected a subfolder named after a domain, such as com.example",
            quote(folder)
        );
        findings.add(&EXTRA_DOMAIN, format!("extra/{folder}"), text);
    }
}

/// Checks that the listed source files exist, and that each is listed once.
fn sources(root: &Element<'_>, archive: &Archive, findings: &mut Findings) {
    let names: HashSet<&str> = archive.names.iter().map(String::as_str).collect();
    for kind in INTERFACES {
        let mut listed = HashSet::new();
        for file in root
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
