//! Checks of the archive and of the files that it must contain: binaries, sources with
//! `sources/buildDescription.xml` (FMI 3.0.2, section 2.4.10), folders, and
//! `terminalsAndIcons/terminalsAndIcons.xml` (FMI 3.0.2, section 2.4.9).

use std::collections::{BTreeSet, HashMap, HashSet};

use fmi_abi::{Interface, fmi3};
use fmu_description::xml::{self, Element};
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::{self, Archive};
use fmu_file::platform::{self, Platform};
use fmu_file::text::quote;

use crate::finding::{Findings, Location, find, require};
use crate::rule::rules;
use crate::schema;

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
fn xml_file(name: &str, archive: &mut Archive, findings: &mut Findings) -> Option<String> {
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

/// How to build the sources.
const BUILD_FILE: &str = "sources/buildDescription.xml";

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
pub fn check_sources(root: &Element<'_>, archive: &mut Archive, findings: &mut Findings) -> bool {
    let is_file = |name: &&String| name.starts_with("sources/") && !name.ends_with('/');
    match findings.version() {
        FmiVersion::Fmi2 => {
            listed(root, &Names::of(archive), findings);
            interfaces(root).any(|interface| interface.child("SourceFiles").is_some())
        }
        FmiVersion::Fmi3 => {
            if archive.names.iter().any(|name| is_file(&name)) {
                described(root, archive, findings);
            }
            archive.names.iter().any(|name| name == BUILD_FILE)
        }
    }
}

/// The names of all files.
struct Names<'a>(HashSet<&'a str>);

impl<'a> Names<'a> {
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
fn listed(root: &Element<'_>, sources: &Names<'_>, findings: &mut Findings) {
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
    let Some(text) = xml_file(BUILD_FILE, archive, findings) else {
        return find!(findings, BUILD_GIVEN at "sources",
            "it has no {BUILD_FILE}, expected it beside the sources");
    };
    let document = match xml::parse(&text) {
        Ok(document) => document,
        Err(error) => return find!(findings, BUILD_GIVEN at BUILD_FILE, "{error:#}"),
    };
    schema::check(BUILD_FILE, &document, &schema::BUILD, findings);
    let identifiers: HashSet<&str> = interfaces(root)
        .filter_map(|interface| interface.attribute("modelIdentifier"))
        .collect();
    let sources = Names::of(archive);
    let mut platforms = HashSet::new();
    for configuration in document.children("BuildConfiguration") {
        let at = || Location::of(BUILD_FILE, configuration);
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
                sources.find(name, Location::of(BUILD_FILE, file), findings);
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
            require!(findings, BUILD_ONCE at Location::of(BUILD_FILE, element), names.insert(name),
                "the {kind} {} appears twice, expected once", quote(name));
        }
    }
    require!(findings, BUILD_COMPILER at Location::of(BUILD_FILE, set),
        set.has("compiler") || !set.has("compilerOptions"),
        "it has compilerOptions and no compiler, expected both");
    for definition in set.children("PreprocessorDefinition") {
        if let Some(value) = definition.attribute("value") {
            let mut options = definition.children("Option").peekable();
            let is_free = options.peek().is_none();
            require!(findings, BUILD_OPTION at Location::of(BUILD_FILE, definition),
                is_free || options.any(|option| option.attribute("value") == Some(value)),
                "value is {}, expected that of an Option", quote(value));
        }
    }
}

const ICONS: &str = "terminalsAndIcons";
const TERMINALS_FILE: &str = "terminalsAndIcons/terminalsAndIcons.xml";

rules! {
    /// Terminals and icons.
    pub TERMINALS {
        TERMINALS_READABLE: Error, "terminals-readable", Fmi3("section 2.4.9"),
            "terminalsAndIcons.xml is well-formed.";
        TERMINALS_VERSION: Error, "terminals-version", Fmi3("section 2.4.9"),
            "terminalsAndIcons.xml has the fmiVersion of the model description.";
        TERMINAL_UNIQUE: Error, "terminal-unique", Fmi3("section 2.4.9.2.2"),
            "The terminals of each level have different names, which are not empty.";
        MEMBER_EXISTS: Error, "member-exists", Fmi3("section 2.4.9.2.3"),
            "The members of a terminal are variables.";
        MEMBER_NAMED: Error, "member-named", Fmi3("section 2.4.9.2.3"),
            "The members of a terminal with the matching rule plug or bus have a memberName of their own.";
        MEMBER_CAUSALITY: Error, "member-causality", Fmi3("section 2.4.9.2.3"),
            "A signal, flow or stream is an input, output, parameter or calculated parameter.";
        STREAM_FLOW: Error, "stream-flow", Fmi3("section 2.4.9.2.4"),
            "A terminal with a stream has at most one inflow or outflow.";
        COORDINATES: Error, "coordinates", Fmi3("section 2.4.9.1.2"),
            "The first corner of the coordinate system is left of and below the second.";
        ICON_EXISTS: Error, "icon-exists", Fmi3("section 2.4.9.2.5"),
            "The icon of a terminal is a PNG file in terminalsAndIcons.";
    }
}

/// What the terminals refer to.
struct Context<'a> {
    /// The causality of each variable and alias, by name.
    causalities: HashMap<&'a str, &'a str>,
    files: HashSet<&'a str>,
}

/// Checks the file, if the FMU has it.
pub fn check_terminals(
    model: &ModelDescription<'_>,
    archive: &mut Archive,
    findings: &mut Findings,
) {
    let Some(text) = xml_file(TERMINALS_FILE, archive, findings) else {
        return;
    };
    let document = match xml::parse(&text) {
        Ok(document) => document,
        Err(error) => return find!(findings, TERMINALS_READABLE at TERMINALS_FILE, "{error:#}"),
    };
    schema::check(TERMINALS_FILE, &document, &schema::TERMINALS, findings);
    let [expected, found] = [model.root, &document].map(|root| root.attribute("fmiVersion"));
    if let (Some(expected), Some(found)) = (expected, found) {
        require!(findings, TERMINALS_VERSION at Location::of(TERMINALS_FILE, &document), expected == found,
            "fmiVersion is {}, expected {} as in the model description", quote(found), quote(expected));
    }
    for system in document.list("GraphicalRepresentation", "CoordinateSystem") {
        for (first, second) in [("x1", "x2"), ("y1", "y2")] {
            if let (Some(low), Some(high)) = (system.real(first), system.real(second)) {
                require!(findings, COORDINATES at Location::of(TERMINALS_FILE, system), low < high,
                    "{first} is {low} and {second} is {high}, expected {first} < {second}");
            }
        }
    }
    let variables = model.root.child("ModelVariables").into_iter();
    let names = variables
        .flat_map(|list| &list.children)
        .flat_map(|variable| {
            let causality = variable.attribute("causality").unwrap_or("local");
            let elements = [variable].into_iter().chain(variable.children("Alias"));
            elements.filter_map(move |element| Some((element.attribute("name")?, causality)))
        });
    let context = Context {
        causalities: names.collect(),
        files: archive.names.iter().map(String::as_str).collect(),
    };
    if let Some(terminals) = document.child("Terminals") {
        level(terminals, &context, findings);
    }
}

/// Checks the terminals of one level, and those in them.
fn level(parent: &Element<'_>, context: &Context<'_>, findings: &mut Findings) {
    let mut names = HashSet::new();
    for terminal in parent.children("Terminal") {
        if let Some(name) = terminal.attribute("name") {
            require!(findings, TERMINAL_UNIQUE at Location::of(TERMINALS_FILE, terminal),
                !name.is_empty() && names.insert(name),
                "the name of the terminal is {}, expected one of its own", quote(name));
        }
        members(terminal, context, findings);
        for graphical in terminal.children("TerminalGraphicalRepresentation") {
            if let Some(base) = graphical.attribute("iconBaseName") {
                let path = archive::relative(&format!("{ICONS}/{base}.png"));
                let exists = path.is_ok_and(|path| context.files.contains(path.as_str()));
                require!(findings, ICON_EXISTS at Location::of(TERMINALS_FILE, graphical), exists,
                    "iconBaseName is {}, expected a PNG file of that name in {ICONS}", quote(base));
            }
        }
        level(terminal, context, findings);
    }
}

fn members(terminal: &Element<'_>, context: &Context<'_>, findings: &mut Findings) {
    let is_matched_by_name = matches!(terminal.attribute("matchingRule"), Some("plug" | "bus"));
    let mut names = HashSet::new();
    let mut flows = 0;
    for member in terminal.children("TerminalMemberVariable") {
        let kind = member.attribute("variableKind").unwrap_or_default();
        let is_known = matches!(kind, "signal" | "inflow" | "outflow");
        flows += usize::from(matches!(kind, "inflow" | "outflow"));
        member_variable(member, "variableName", is_known, context, findings);
        let name = member.attribute("memberName");
        let is_own = name.is_some_and(|name| !name.is_empty() && names.insert(name));
        require!(findings, MEMBER_NAMED at Location::of(TERMINALS_FILE, member), is_own || !is_matched_by_name,
            "memberName is {}, expected one of its own", name.map_or("missing".into(), quote));
    }
    for member in terminal.children("TerminalStreamMemberVariable") {
        for (name, of) in [
            ("inStreamMemberName", "inStreamVariableName"),
            ("outStreamMemberName", "outStreamVariableName"),
        ] {
            member_variable(member, of, true, context, findings);
            if let Some(name) = member.attribute(name).filter(|_| is_matched_by_name) {
                require!(findings, MEMBER_NAMED at Location::of(TERMINALS_FILE, member), names.insert(name),
                    "the member name {} appears twice, expected once", quote(name));
            }
        }
        require!(findings, STREAM_FLOW at Location::of(TERMINALS_FILE, member), flows <= 1,
            "its terminal has {flows} inflows and outflows, expected at most one");
    }
}

/// Checks that an attribute names a variable, which has a causality that a member of a known kind may have.
fn member_variable(
    member: &Element<'_>,
    attribute: &str,
    is_known: bool,
    context: &Context<'_>,
    findings: &mut Findings,
) {
    let Some(name) = member.attribute(attribute) else {
        return;
    };
    let (at, shown) = (Location::of(TERMINALS_FILE, member), quote(name));
    match context.causalities.get(name) {
        None => find!(findings, MEMBER_EXISTS at at,
            "{attribute} is {shown}, expected the name of a variable"),
        Some(causality) => require!(findings, MEMBER_CAUSALITY at at,
            !is_known || ["input", "output", "parameter", "calculatedParameter"].contains(causality),
            "{attribute} is {shown} with causality {}, expected input, output, parameter or \
             calculatedParameter", quote(causality)),
    }
}
