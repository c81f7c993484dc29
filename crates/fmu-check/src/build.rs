//! Checks of `sources/buildDescription.xml` (FMI 3.0.2, section 2.4.10).

use std::collections::HashSet;

use fmu_description::xml::{self, Element};
use fmu_file::archive::{self, Archive};
use fmu_file::text::quote;

use crate::finding::{Findings, Location};
use crate::package::{self, INTERFACES, SOURCES_EXIST};
use crate::rule::rules;
use crate::schema::{self, build::BUILD_DESCRIPTION};

/// How to build the sources.
pub const FILE: &str = "sources/buildDescription.xml";

rules! {
    /// The description of the sources.
    pub BUILD {
        BUILD_GIVEN: Error, "build-given", Fmi3("section 2.5.1"),
            "The folder sources has a well-formed buildDescription.xml.";
        BUILD_IDENTIFIER: Error, "build-identifier", Fmi3("section 2.4.10"),
            "A build configuration has the modelIdentifier of an interface type.";
        BUILD_PLATFORM: Error, "build-platform", Fmi3("section 2.4.10"),
            "The build configurations of a modelIdentifier have different platforms.";
        BUILD_SOURCES: Error, "build-sources", Fmi3("section 2.4.10"),
            "A build configuration has a set of source files.";
        BUILD_ONCE: Warning, "build-once", Practice("VDMCheck3 requires it, and a file that is compiled twice does not link"),
            "A set of source files lists each file, definition and include directory once.";
        BUILD_COMPILER: Warning, "build-compiler", Practice("VDMCheck3 requires it"),
            "Compiler options are given with the compiler.";
        BUILD_OPTION: Error, "build-option", Fmi3("section 2.4.10"),
            "The value of a preprocessor definition with options is one of them.";
    }
}

/// Checks the sources, if the FMU has any; `root` is that of the model description.
pub fn check(root: &Element<'_>, archive: &mut Archive, findings: &mut Findings) {
    let is_source = |name: &&String| name.starts_with("sources/") && !name.ends_with('/');
    if !archive.names.iter().any(|name| is_source(&name)) {
        return;
    }
    let Some(text) = package::xml(FILE, archive, findings) else {
        let text = format!("it has no {FILE}, expected it beside the sources");
        return findings.add(&BUILD_GIVEN, "sources", text);
    };
    let document = match xml::parse(&text) {
        Ok(document) => document,
        Err(error) => return findings.add(&BUILD_GIVEN, FILE, format!("{error:#}")),
    };
    schema::check(FILE, &document, &BUILD_DESCRIPTION, findings);
    let identifiers: HashSet<&str> = (root.children.iter())
        .filter(|child| INTERFACES.contains(&child.name))
        .filter_map(|interface| interface.attribute("modelIdentifier"))
        .collect();
    let names: HashSet<&str> = archive.names.iter().map(String::as_str).collect();
    let mut platforms = HashSet::new();
    for configuration in document.children("BuildConfiguration") {
        let at = || Location::of(FILE, configuration);
        let identifier = configuration
            .attribute("modelIdentifier")
            .unwrap_or_default();
        if !identifiers.contains(identifier) {
            let text = format!(
                "modelIdentifier is {}, expected that of an interface type",
                quote(identifier)
            );
            findings.add(&BUILD_IDENTIFIER, at(), text);
        }
        let platform = configuration.attribute("platform");
        if !platforms.insert((identifier, platform)) {
            let platform = platform.map_or("no platform".into(), quote);
            let text = format!("two configurations have {platform}, expected one");
            findings.add(&BUILD_PLATFORM, at(), text);
        }
        if configuration.child("SourceFileSet").is_none() {
            findings.add(
                &BUILD_SOURCES,
                at(),
                "it has no SourceFileSet, expected one",
            );
        }
        let sets = || configuration.children("SourceFileSet");
        sets().for_each(|set| source_set(set, findings));
        for file in sets().flat_map(|set| set.children("SourceFile")) {
            let name = file.attribute("name").unwrap_or_default();
            let path = archive::relative(&format!("sources/{name}"));
            if !path.is_ok_and(|path| names.contains(path.as_str())) {
                let name = quote(name);
                let text = format!("the source file {name} is missing, expected it in sources");
                findings.add(&SOURCES_EXIST, Location::of(FILE, file), text);
            }
        }
    }
}

/// Checks what a set of source files is compiled with.
fn source_set(set: &Element<'_>, findings: &mut Findings) {
    for kind in ["SourceFile", "PreprocessorDefinition", "IncludeDirectory"] {
        let mut names = HashSet::new();
        for element in set.children(kind) {
            let name = element.attribute("name").unwrap_or_default();
            if !names.insert(name) {
                let text = format!("the {kind} {} appears twice, expected once", quote(name));
                findings.add(&BUILD_ONCE, Location::of(FILE, element), text);
            }
        }
    }
    if set.attribute("compilerOptions").is_some() && set.attribute("compiler").is_none() {
        let text = "it has compilerOptions and no compiler, expected both";
        findings.add(&BUILD_COMPILER, Location::of(FILE, set), text);
    }
    for definition in set.children("PreprocessorDefinition") {
        let Some(value) = definition.attribute("value") else {
            continue;
        };
        let mut options = definition.children("Option").peekable();
        if options.peek().is_some() && !options.any(|o| o.attribute("value") == Some(value)) {
            let text = format!("value is {}, expected that of an Option", quote(value));
            findings.add(&BUILD_OPTION, Location::of(FILE, definition), text);
        }
    }
}
