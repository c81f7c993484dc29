//! Checks of the archive and of the files that it must contain.

use std::collections::{BTreeSet, HashSet};

use fmi_abi::{Interface, fmi3};
use fmu_description::FmiVersion;
use fmu_description::xml::{self, Element};
use fmu_file::archive::Archive;
use fmu_file::platform::{self, Platform};
use fmu_file::text::quote;

use crate::finding::{Findings, find, require};
use crate::rule::rules;

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

    /// The functions of a binary.
    pub EXPORTS {
        EXPORTED: Error, "functions-exported", Fmi3("section 2.5"),
            "A binary exports all functions of its interface types.";
    }
}

/// Names of the interface types.
pub const INTERFACES: [&str; 3] = ["ModelExchange", "CoSimulation", "ScheduledExecution"];

/// Larger binaries are not read.
const MAX_BINARY: u64 = 128 << 20;

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

/// Checks that there are sources or binaries, and that each interface type has its binary for each platform.
pub fn check_binaries(
    root: &Element<'_>,
    has_sources: bool,
    archive: &mut Archive,
    findings: &mut Findings,
) {
    let folders = platform::folders(&archive.names).into_iter();
    let folders: BTreeSet<String> = folders.map(str::to_owned).collect();
    require!(findings, BINARIES_OR_SOURCES at "archive", has_sources || !folders.is_empty(),
        "it has neither binaries nor sources, expected at least one of the two");
    for folder in folders {
        match Platform::named(&folder, findings.version()) {
            Ok(platform) => binaries(root, platform, archive, findings),
            Err(_) if findings.version() == FmiVersion::Fmi3 && is_static(&folder) => {}
            Err(error) => {
                find!(findings, KNOWN_PLATFORM at format!("binaries/{folder}"), "{error}")
            }
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
            find!(findings, BINARY_NAMED at format!("binaries/{}", platform.folder),
                "it has no {}, expected the binary that modelIdentifier names", quote(&file));
            continue;
        }
        let head = archive.head(&file, Platform::HEAD);
        match head.and_then(|head| platform.check(&head)) {
            Err(error) => find!(findings, BINARY_FORMAT at file, "{error:#}"),
            Ok(()) if findings.version() == FmiVersion::Fmi3 => {
                exports(&file, identifier, root, archive, findings);
            }
            Ok(()) => {}
        }
    }
}

/// Checks which functions of FMI 3.0 a binary exports, without running it, so also those for other machines.
/// It is the shared library of all interface types with this identifier.
fn exports(
    file: &str,
    identifier: &str,
    root: &Element<'_>,
    archive: &mut Archive,
    findings: &mut Findings,
) {
    let Ok(binary) = archive.head(file, MAX_BINARY + 1) else {
        return;
    };
    // The names that a binary of macOS exports may be compressed.
    let has_plain_names = binary.starts_with(b"\x7fELF") || binary.starts_with(b"MZ");
    if binary.len() as u64 > MAX_BINARY || !has_plain_names {
        return;
    }
    let is_of = |interface: &str| {
        let mut own = interfaces(root).filter(|own| own.name == interface);
        own.any(|own| own.attribute("modelIdentifier") == Some(identifier))
    };
    let functions = fmi3::FUNCTIONS.iter().map(|(function, _)| function);
    let required = functions.filter(|function| {
        match (
            function.name.strip_prefix("fmi3Instantiate"),
            function.interface,
        ) {
            (Some(interface), _) => is_of(interface),
            (None, Interface::All) => true,
            (None, interface) => is_of(&format!("{interface:?}")),
        }
    });
    for name in missing(&binary, required.map(|function| function.name)) {
        find!(findings, EXPORTED at file,
            "it does not export {name}, expected all functions of its interface types");
    }
}

/// The names that are not in a binary as texts with a zero byte behind.
fn missing(binary: &[u8], names: impl Iterator<Item = &'static str>) -> BTreeSet<&'static str> {
    const PREFIX: &[u8] = b"fmi3";
    const MAX_LENGTH: usize = 64;
    let mut missing: BTreeSet<&str> = names.collect();
    for at in 0..binary.len() {
        let rest = &binary[at..];
        if rest.starts_with(PREFIX)
            && let Some(end) = rest.iter().take(MAX_LENGTH).position(|byte| *byte == 0)
            && let Ok(name) = str::from_utf8(&rest[..end])
        {
            missing.remove(name);
        }
    }
    missing
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
        let [vector_exists, pixels_exist] =
            [&vector, &pixels].map(|name| names.contains(name.as_str()));
        require!(findings, IMAGE_PNG at vector, pixels_exist || !vector_exists,
            "it has no {pixels} beside it, expected both");
    }
    const LICENCES: &str = "documentation/licenses/";
    let has_one = |base: &str, extensions: &[&str]| {
        let mut extensions = extensions.iter();
        extensions.any(|extension| names.contains(format!("{base}.{extension}").as_str()))
    };
    let is_file_in = |folder| move |name: &&&str| name.starts_with(folder) && !name.ends_with('/');
    let has_licences = names.iter().any(|name| is_file_in(LICENCES)(&name));
    let has_entry = has_one(&format!("{LICENCES}license"), &["spdx", "txt", "html"]);
    require!(findings, LICENCE_ENTRY at LICENCES, has_entry || !has_licences,
        "it has no license.txt, license.html or license.spdx, expected one of them");
    let has_page = has_one("documentation/staticLinking", &["txt", "html"]);
    for folder in platform::folders(&archive.names) {
        require!(findings, STATIC_LINKING at format!("binaries/{folder}"),
            has_page || !is_static(folder),
            "it holds a static library, expected documentation/staticLinking.txt or .html");
    }
    let folders: BTreeSet<&str> = (names.iter())
        .filter(is_file_in("extra/"))
        .filter_map(|name| name.split('/').nth(1))
        .collect();
    for folder in folders {
        require!(findings, EXTRA_DOMAIN at format!("extra/{folder}"), folder.contains('.'),
            "it is {}, expected a subfolder named after a domain, such as com.example", quote(folder));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_end_with_a_zero_byte() {
        // The last has no end; a name may be the end of another.
        let binary = b"\0fmi3Reset\0my_fmi3DoStep\0fmi3SetTimes\0fmi3Terminate";
        let names = ["fmi3Reset", "fmi3DoStep", "fmi3SetTime", "fmi3Terminate"];
        let missing = missing(binary, names.into_iter());
        assert_eq!(missing, BTreeSet::from(["fmi3SetTime", "fmi3Terminate"]));
    }
}
