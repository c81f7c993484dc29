//! Checks of the sources: those that a model description of FMI 2.0 lists, and
//! `sources/buildDescription.xml` of FMI 3.0 (FMI 3.0.2, section 2.4.10).

use std::collections::HashSet;

use fmu_description::FmiVersion;
use fmu_description::xml::{self, Element};
use fmu_file::archive::{self, Archive};
use fmu_file::text::quote;

use crate::finding::{Findings, Location, find, require};
use crate::package::{self, INTERFACES, SOURCES_EXIST, SOURCES_UNIQUE, interfaces};
use crate::rule::rules;
use crate::schema;

/// How to build the sources.
const FILE: &str = "sources/buildDescription.xml";

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

/// Checks the sources; returns whether the FMU has any. `root` is the root of the model description.
pub fn check(root: &Element<'_>, archive: &mut Archive, findings: &mut Findings) -> bool {
    let is_file = |name: &&String| name.starts_with("sources/") && !name.ends_with('/');
    match findings.version() {
        FmiVersion::Fmi2 => {
            listed(root, &Sources::of(archive), findings);
            interfaces(root).any(|interface| interface.child("SourceFiles").is_some())
        }
        FmiVersion::Fmi3 => {
            if archive.names.iter().any(|name| is_file(&name)) {
                described(root, archive, findings);
            }
            archive.names.iter().any(|name| name == FILE)
        }
    }
}

/// The names of all files.
struct Sources<'a>(HashSet<&'a str>);

impl<'a> Sources<'a> {
    fn of(archive: &'a Archive) -> Self {
        Self(archive.names.iter().map(String::as_str).collect())
    }

    /// Checks that a source file exists; returns its path, or else its name.
    fn find(&self, name: &str, at: Location, findings: &mut Findings) -> String {
        let path = archive::relative(&format!("sources/{name}"));
        let exists = path
            .as_ref()
            .is_ok_and(|path| self.0.contains(path.as_str()));
        require!(findings, SOURCES_EXIST at at, exists,
            "the source file {} is missing, expected it in sources", quote(name));
        path.unwrap_or_else(|_| name.to_owned())
    }
}

/// Checks that the source files that an interface type lists exist, and that each is listed once.
fn listed(root: &Element<'_>, sources: &Sources<'_>, findings: &mut Findings) {
    for kind in INTERFACES {
        let mut listed = HashSet::new();
        let interfaces = root.children(kind);
        for file in interfaces.flat_map(|kind| kind.list("SourceFiles", "File")) {
            if let Some(name) = file.attribute("name") {
                let path = sources.find(name, file.into(), findings);
                require!(findings, SOURCES_UNIQUE at file, listed.insert(path),
                    "the source file {} is listed twice, expected once", quote(name));
            }
        }
    }
}

/// Checks `buildDescription.xml`.
fn described(root: &Element<'_>, archive: &mut Archive, findings: &mut Findings) {
    let Some(text) = package::xml(FILE, archive, findings) else {
        return find!(findings, BUILD_GIVEN at "sources",
            "it has no {FILE}, expected it beside the sources");
    };
    let document = match xml::parse(&text) {
        Ok(document) => document,
        Err(error) => return find!(findings, BUILD_GIVEN at FILE, "{error:#}"),
    };
    schema::check(FILE, &document, &schema::BUILD, findings);
    let identifiers: HashSet<&str> = interfaces(root)
        .filter_map(|interface| interface.attribute("modelIdentifier"))
        .collect();
    let sources = Sources::of(archive);
    let mut platforms = HashSet::new();
    for configuration in document.children("BuildConfiguration") {
        let at = || Location::of(FILE, configuration);
        let identifier = configuration.attribute("modelIdentifier");
        let identifier = identifier.unwrap_or_default();
        require!(findings, BUILD_IDENTIFIER at at(), identifiers.contains(identifier),
            "modelIdentifier is {}, expected that of an interface type", quote(identifier));
        let platform = configuration.attribute("platform");
        require!(findings, BUILD_PLATFORM at at(), platforms.insert((identifier, platform)),
            "two configurations have {}, expected one", platform.map_or("no platform".into(), quote));
        require!(findings, BUILD_SOURCES at at(), configuration.child("SourceFileSet").is_some(),
            "it has no SourceFileSet, expected one");
        for set in configuration.children("SourceFileSet") {
            source_set(set, findings);
            for file in set.children("SourceFile") {
                let name = file.attribute("name").unwrap_or_default();
                sources.find(name, Location::of(FILE, file), findings);
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
            require!(findings, BUILD_ONCE at Location::of(FILE, element), names.insert(name),
                "the {kind} {} appears twice, expected once", quote(name));
        }
    }
    require!(findings, BUILD_COMPILER at Location::of(FILE, set),
        set.has("compiler") || !set.has("compilerOptions"),
        "it has compilerOptions and no compiler, expected both");
    for definition in set.children("PreprocessorDefinition") {
        if let Some(value) = definition.attribute("value") {
            let mut options = definition.children("Option").peekable();
            let is_free = options.peek().is_none();
            require!(findings, BUILD_OPTION at Location::of(FILE, definition),
                is_free || options.any(|option| option.attribute("value") == Some(value)),
                "value is {}, expected that of an Option", quote(value));
        }
    }
}
