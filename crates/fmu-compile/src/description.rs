//! How an FMU says that its sources are built: `sources/buildDescription.xml` (FMI 3.0.2, section 2.6; FMI 2.0.5,
//! section 2.3), or the elements `SourceFiles` of FMI 2.0.

use std::collections::BTreeMap;

use anyhow::Context;
use fmu_description::FmiVersion;
use fmu_description::xml::{self, Element};
use fmu_file::archive::{self, Archive};
use fmu_file::platform::Platform;
use fmu_file::text::quote;

use crate::error::{CompileError, invalid};
use crate::options::{self, CompilerFamily, CompilerOption, KnownCompiler, is_library_name};

/// The folder of the sources.
pub const SOURCES: &str = "sources/";
/// How to build the sources.
const BUILD_FILE: &str = "sources/buildDescription.xml";
/// The interface types.
const INTERFACES: [&str; 3] = ["ModelExchange", "CoSimulation", "ScheduledExecution"];

/// How the library with a model identifier is built.
#[derive(Debug)]
pub struct Recipe {
    pub identifier: String,
    /// The interface types with this identifier.
    pub interfaces: Vec<&'static str>,
    pub sets: Vec<SourceSet>,
    pub libraries: Vec<NeededLibrary>,
}

/// Source files with the same options. Paths are relative to the FMU.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct SourceSet {
    /// The language of all files; by default, of each by its name.
    pub language: Option<Language>,
    /// The compiler that the options are for, if it is known.
    pub family: Option<CompilerFamily>,
    /// The compiler to take if this machine has it.
    pub preferred: Option<KnownCompiler>,
    pub options: Vec<CompilerOption>,
    pub files: Vec<String>,
    pub definitions: Vec<Definition>,
    /// Folders in which included files are.
    pub includes: Vec<String>,
}

/// A definition of the preprocessor.
#[derive(Debug, Clone, PartialEq)]
pub struct Definition {
    pub name: String,
    pub value: Option<String>,
}

/// A library to link.
#[derive(Debug, Clone, PartialEq)]
pub enum NeededLibrary {
    /// A library of the system.
    System(String),
    /// The path of a file in the FMU.
    InFmu(String),
}

/// The language of a source file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Language {
    pub is_cpp: bool,
    /// The year of its standard, such as `99`.
    pub year: Option<&'static str>,
}

/// The years of the standards of C and C++.
const C_YEARS: [&str; 8] = ["89", "90", "95", "99", "11", "17", "18", "23"];
const CPP_YEARS: [&str; 8] = ["98", "03", "11", "14", "17", "20", "23", "26"];

impl Language {
    /// Reads the attribute `language`, such as `C99` or `C++11`.
    fn named(text: &str) -> Result<Self, CompileError> {
        let upper = text.trim().to_uppercase();
        let unknown = || CompileError::Language(format!("the language {}", quote(text)));
        let rest = upper.strip_prefix('C').ok_or_else(unknown)?;
        let (is_cpp, year, years) = match rest.strip_prefix("++").or(rest.strip_prefix("PP")) {
            Some(year) => (true, year, CPP_YEARS),
            None => (false, rest, C_YEARS),
        };
        let known = years.into_iter().find(|known| *known == year);
        match known {
            None if !year.is_empty() => Err(unknown()),
            year => Ok(Self { is_cpp, year }),
        }
    }

    /// The language of a file by its name; `None` for a header.
    pub fn of_file(path: &str) -> Result<Option<Self>, CompileError> {
        let name = path.rsplit('/').next().unwrap_or_default();
        let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension);
        let is_cpp = match extension {
            "c" => false,
            // As compilers do, which know no `.C` on Windows.
            "C" | "cc" | "cpp" | "cxx" | "c++" | "CPP" => true,
            "h" | "hh" | "hpp" | "hxx" | "inc" => return Ok(None),
            _ => return Err(CompileError::Language(format!("the file {}", quote(name)))),
        };
        Ok(Some(Self { is_cpp, year: None }))
    }

    /// The option that selects its standard, with the extensions that sources usually need.
    pub fn option(&self, family: CompilerFamily) -> Option<String> {
        let year = self.year?;
        match (family, self.is_cpp) {
            (CompilerFamily::Gnu, false) => {
                let year = if year == "95" { "90" } else { year };
                Some(format!("-std=gnu{year}"))
            }
            (CompilerFamily::Gnu, true) => Some(format!("-std=gnu++{year}")),
            // Older standards are the default.
            (CompilerFamily::Msvc, false) if ["11", "17", "18"].contains(&year) => {
                Some(format!("-std:c{}", if year == "18" { "17" } else { year }))
            }
            (CompilerFamily::Msvc, true) if ["14", "17", "20"].contains(&year) => {
                Some(format!("-std:c++{year}"))
            }
            (CompilerFamily::Msvc, _) => None,
        }
    }
}

/// The platform whose binaries are compiled.
///
/// # Errors
/// The version of FMI has no name for it.
pub fn platform(version: FmiVersion) -> Result<Platform, CompileError> {
    let number = version.as_str();
    let platform = Platform::of_this_machine(version);
    Ok(platform.with_context(|| format!("FMI {number} does not define this platform"))?)
}

/// What an FMU says about its sources.
#[derive(Debug)]
pub struct Recipes {
    /// One for each model identifier.
    pub all: Vec<Recipe>,
    /// What was left out.
    pub notes: Vec<String>,
}

impl Recipes {
    /// Reads how the sources of an FMU are built on this platform.
    ///
    /// # Errors
    /// The description is missing or invalid, or has nothing for this platform.
    pub fn read(
        archive: &mut Archive,
        root: &Element<'_>,
        version: FmiVersion,
    ) -> Result<Self, CompileError> {
        // Build descriptions name platforms as FMI 3.0 does.
        let platform = platform(FmiVersion::Fmi3)?;
        let mut identifiers = BTreeMap::<String, Vec<&'static str>>::new();
        for kind in INTERFACES {
            for element in root.children(kind) {
                let identifier = element.attribute("modelIdentifier").unwrap_or_default();
                let is_name = !identifier.is_empty()
                    && archive::relative(identifier).is_ok_and(|name| name == identifier)
                    && !identifier.contains('/');
                if !is_name {
                    let quoted = quote(identifier);
                    return invalid(format!(
                        "the modelIdentifier is {quoted}, expected the name of a file"
                    ));
                }
                identifiers.entry(identifier.to_owned()).or_default().push(kind);
            }
        }
        if identifiers.is_empty() {
            return invalid("it has no interface type");
        }
        let mut names = archive.names.iter();
        if !names.any(|name| name.starts_with(SOURCES) && !name.ends_with('/')) {
            return Err(CompileError::NoSources);
        }
        let mut notes = Vec::new();
        let build = archive.text(BUILD_FILE)?;
        let build = match &build {
            Some(text) => Some(xml::parse(text).map_err(|error| {
                CompileError::Description(format!("{BUILD_FILE} cannot be read: {error:#}"))
            })?),
            None if version == FmiVersion::Fmi3 => {
                return invalid(format!(
                    "it has no {BUILD_FILE}, which FMI 3.0 demands of sources"
                ));
            }
            None => None,
        };
        let mut all = Vec::new();
        for (identifier, interfaces) in identifiers {
            let (sets, libraries) = match &build {
                Some(build) => {
                    let configuration = configuration(build, &identifier, &platform)?;
                    built_by(configuration, &archive.names, &platform, &mut notes)?
                }
                None => (vec![listed(root, &identifier, &archive.names, &mut notes)?], Vec::new()),
            };
            for path in sets.iter().flat_map(|set| &set.files) {
                if !archive.names.contains(path) {
                    let path = path.clone();
                    return Err(CompileError::MissingFile { kind: "source file", path });
                }
            }
            all.push(Recipe { identifier, interfaces, sets, libraries });
        }
        Ok(Self { all, notes })
    }
}

/// The configuration for a model identifier and a platform: the one that names the platform, or else the one that
/// names none.
fn configuration<'a, 'b>(
    build: &'a Element<'b>,
    identifier: &str,
    platform: &Platform,
) -> Result<&'a Element<'b>, CompileError> {
    let is_own =
        |of: &&Element<'_>| of.attribute("modelIdentifier").map(str::trim) == Some(identifier);
    let own = || build.children("BuildConfiguration").filter(is_own);
    let is_here = |of: &&Element<'_>| {
        let name = of.attribute("platform").map(str::trim);
        name.is_some_and(|name| platform.is_named(name))
    };
    let found = own().find(is_here).or_else(|| own().find(|of| !of.has("platform")));
    found.map_or_else(
        || {
            let described = own().filter_map(|of| Some(quote(of.attribute("platform")?)));
            match Vec::from_iter(described) {
                described if described.is_empty() => invalid(format!(
                    "{BUILD_FILE} has no BuildConfiguration for the modelIdentifier {}",
                    quote(identifier)
                )),
                described => Err(CompileError::Platform { here: platform.folder, described }),
            }
        },
        Ok,
    )
}

/// The source files and libraries of a configuration.
fn built_by(
    configuration: &Element<'_>,
    names: &[String],
    platform: &Platform,
    notes: &mut Vec<String>,
) -> Result<(Vec<SourceSet>, Vec<NeededLibrary>), CompileError> {
    let mut libraries = Vec::new();
    let mut sets = Vec::new();
    for set in configuration.children("SourceFileSet") {
        sets.push(source_set(set, &mut libraries, notes)?);
    }
    if sets.iter().all(|set| set.files.is_empty()) {
        return invalid(format!("{BUILD_FILE} has no SourceFile, expected one or more"));
    }
    for library in configuration.children("Library") {
        libraries.push(needed_library(library, names, platform)?);
    }
    Ok((sets, libraries))
}

fn source_set(
    set: &Element<'_>,
    libraries: &mut Vec<NeededLibrary>,
    notes: &mut Vec<String>,
) -> Result<SourceSet, CompileError> {
    let language = set.attribute("language").filter(|text| !text.trim().is_empty());
    let compiler = set.attribute("compiler").map(str::trim).filter(|name| !name.is_empty());
    let family = compiler.and_then(CompilerFamily::named);
    let text = set.attribute("compilerOptions").unwrap_or_default();
    let mut read = SourceSet {
        language: language.map(Language::named).transpose()?,
        family,
        preferred: compiler.and_then(KnownCompiler::named),
        ..SourceSet::default()
    };
    match (compiler, family) {
        (Some(compiler), None) if !text.trim().is_empty() => notes.push(format!(
            "the options {} are for the compiler {}, and were left out",
            quote(text.trim()),
            quote(compiler)
        )),
        _ => read.options = options::read(text, family)?,
    }
    for file in set.children("SourceFile") {
        read.files.push(path(file)?);
    }
    for folder in set.children("IncludeDirectory") {
        read.includes.push(path(folder)?);
    }
    for option in &read.options {
        match option {
            CompilerOption::Include(folder) => read.includes.push(below_sources(folder)?),
            CompilerOption::Library(name) => {
                libraries.push(NeededLibrary::System(name.clone()));
            }
            CompilerOption::Word(_) => {}
        }
    }
    for definition in set.children("PreprocessorDefinition") {
        let name = definition.attribute("name").unwrap_or_default().trim();
        if !is_identifier(name) {
            let name = quote(name);
            return invalid(format!("the PreprocessorDefinition {name} is not a name in C"));
        }
        let value = definition.attribute("value").map(str::to_owned);
        // The sources have a value of their own for an optional definition without a value.
        if value.is_some() || !definition.is_true("optional") {
            read.definitions.push(Definition { name: name.to_owned(), value });
        }
    }
    Ok(read)
}

/// The path in the FMU that an element names, relative to the sources.
fn path(element: &Element<'_>) -> Result<String, CompileError> {
    below_sources(element.attribute("name").unwrap_or_default())
}

fn below_sources(name: &str) -> Result<String, CompileError> {
    let path = archive::relative(name).map_err(CompileError::Description)?;
    Ok(format!("{SOURCES}{path}").trim_end_matches('/').to_owned())
}

fn is_identifier(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

fn needed_library(
    library: &Element<'_>,
    names: &[String],
    platform: &Platform,
) -> Result<NeededLibrary, CompileError> {
    let name = library.attribute("name").unwrap_or_default().trim();
    if !is_library_name(name) {
        return invalid(format!("the Library {} is not the name of a library", quote(name)));
    }
    if library.is_true("external") {
        return Ok(NeededLibrary::System(name.to_owned()));
    }
    let folders = names.iter().filter_map(|name| {
        let folder = name.strip_prefix("binaries/")?.split_once('/')?.0;
        // Static libraries may be in a folder with an ABI, such as x86_64-linux-gnu.
        let is_own = platform.is_named(folder)
            || folder.match_indices('-').any(|(end, _)| platform.is_named(&folder[..end]));
        is_own.then_some(folder)
    });
    let extension = platform.extension;
    let candidates = [
        name.to_owned(),
        format!("lib{name}.a"),
        format!("{name}.a"),
        format!("{name}.lib"),
        format!("lib{name}.{extension}"),
        format!("{name}.{extension}"),
    ];
    let paths = folders
        .flat_map(|folder| candidates.iter().map(move |file| format!("binaries/{folder}/{file}")));
    let mut paths = paths.filter(|path| names.contains(path));
    paths.next().map(NeededLibrary::InFmu).ok_or_else(|| CompileError::MissingFile {
        kind: "library",
        path: format!("binaries/{}/{name}", platform.folder),
    })
}

/// The source files that FMI 2.0 lists for a model identifier; if it lists none, all in the folder.
fn listed(
    root: &Element<'_>,
    identifier: &str,
    names: &[String],
    notes: &mut Vec<String>,
) -> Result<SourceSet, CompileError> {
    let interfaces = root.children.iter().filter(|child| {
        INTERFACES.contains(&child.name) && child.attribute("modelIdentifier") == Some(identifier)
    });
    let mut files = Vec::new();
    for file in interfaces.flat_map(|interface| interface.list("SourceFiles", "File")) {
        let path = path(file)?;
        if Language::of_file(&path)?.is_some() && !files.contains(&path) {
            files.push(path);
        }
    }
    if files.is_empty() {
        let is_source = |name: &&String| {
            let below = name.strip_prefix(SOURCES);
            below.is_some_and(|name| !name.contains('/'))
                && matches!(Language::of_file(name), Ok(Some(_)))
        };
        files.extend(names.iter().filter(is_source).cloned());
        // A file that includes all the others.
        let all = format!("{SOURCES}all.c");
        if files.contains(&all) {
            files = vec![all];
        }
        if files.is_empty() {
            return Err(CompileError::NoSources);
        }
        let count = files.len();
        notes.push(match count {
            1 => format!("it lists no source files; {} is compiled", files[0]),
            _ => format!("it lists no source files; the {count} in sources are compiled"),
        });
    }
    Ok(SourceSet { files, ..SourceSet::default() })
}
