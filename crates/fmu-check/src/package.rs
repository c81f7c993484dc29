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
use crate::rule::{Rule, rules};
use crate::schema::{self, Schema};

rules! {
    /// The archive and its files.
    pub PACKAGE {
        // What the archive must contain.
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
        DOTTED_NAMES: Warning, "archive-names",
            Practice("importers that look for modelDescription.xml do not find ./modelDescription.xml"),
            "Names do not begin with ./.";
        UTF_8: Error, "utf-8", Standard("section 2.2", "section 2.4"),
            "XML files are encoded in UTF-8.";
        INTACT_FILES: Error, "files-intact", Standard("section 2.3", "section 2.5"),
            "Every file of the archive can be unpacked.";
        BINARIES_OR_SOURCES: Error, "binaries-or-sources", Standard("section 2.3", "section 2.5"),
            "There are binaries or sources.";
        KNOWN_PLATFORM: Warning, "platform-known",
            Practice("importers look for binaries only in the platform folders of the standard"),
            "The folders in binaries are those of the standard.";
        PLATFORM_EMPTY: Warning, "platform-empty",
            Practice("importers look for a binary in each platform folder"),
            "Each platform folder has files.";
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
        // The functions of a binary.
        EXPORTED: Error, "functions-exported", Fmi3("section 2.5"),
            "A binary exports all functions of its interface types.";
        // The description of the sources.
        BUILD_GIVEN: Error, "build-given", Fmi3("section 2.5.1"),
            "The folder sources has a well-formed buildDescription.xml.";
        SOURCES_LEFT: Warning, "sources-left",
            Practice("no importer can build sources without buildDescription.xml, but the binaries run"),
            "The folder sources of an FMU with binaries has a buildDescription.xml.";
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
        // Terminals and icons.
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

/// Names of the interface types.
pub const INTERFACES: [&str; 3] = ["ModelExchange", "CoSimulation", "ScheduledExecution"];

/// Larger binaries are not read.
const MAX_BINARY: u64 = 128 << 20;
/// Maximum number of bytes that are read of an XML file.
const MAX_XML: u64 = 64 << 20;
/// How to build the sources.
const BUILD_FILE: &str = "sources/buildDescription.xml";
const ICONS: &str = "terminalsAndIcons";
const TERMINALS_FILE: &str = "terminalsAndIcons/terminalsAndIcons.xml";

/// Checks that the archive can be unpacked.
pub fn check(archive: &mut Archive, findings: &mut Findings) {
    for fault in &archive.faults {
        findings.add(&SAFE_ARCHIVE, "archive", fault);
    }
    for oddity in &archive.oddities {
        findings.add(&PLAIN_ARCHIVE, "archive", oddity);
    }
    for name in &archive.dotted {
        findings.add(&DOTTED_NAMES, "archive", name);
    }
    // Files that are too large must not be inflated.
    if archive.faults.is_empty() {
        for damage in archive.damages() {
            findings.add(&INTACT_FILES, "archive", damage);
        }
    }
}

/// Checks the files of an FMU.
pub fn check_files(model: &ModelDescription<'_>, archive: &mut Archive, findings: &mut Findings) {
    let mut files =
        Files { model, names: archive.names.iter().cloned().collect(), archive, findings };
    let has_sources = files.sources();
    files.binaries(has_sources);
    if model.version == FmiVersion::Fmi3 {
        files.folders();
        files.document(TERMINALS_FILE, &schema::TERMINALS, &TERMINALS_READABLE, Files::terminals);
    }
}

/// The elements of the interface types.
pub fn interfaces<'a, 'b>(root: &'a Element<'b>) -> impl Iterator<Item = &'a Element<'b>> {
    root.children.iter().filter(|child| INTERFACES.contains(&child.name))
}

/// Whether a folder is for static libraries: a platform of FMI 3.0 and an ABI.
fn is_static(folder: &str) -> bool {
    let abi = folder.match_indices('-').nth(1);
    abi.is_some_and(|(end, _)| Platform::named(&folder[..end], FmiVersion::Fmi3).is_ok())
}

/// The files of an FMU.
struct Files<'a> {
    model: &'a ModelDescription<'a>,
    names: HashSet<String>,
    archive: &'a mut Archive,
    findings: &'a mut Findings,
}

impl<'a> Files<'a> {
    /// The identifiers of the interface types, which are names of binaries.
    fn identifiers(&self) -> BTreeSet<&'a str> {
        let identifiers = interfaces(self.model.root);
        identifiers.filter_map(|of| of.attribute("modelIdentifier")).collect()
    }

    /// Checks an XML file against its schema, and applies further checks; returns whether it exists. Its damage
    /// is reported by [`check`].
    fn document(
        &mut self,
        file: &str,
        schema: &Schema,
        readable: &'static Rule,
        further: impl FnOnce(&mut Self, &Element<'_>),
    ) -> bool {
        let Ok(bytes) = self.archive.head(file, MAX_XML) else { return false };
        let decoded = xml::decode(&bytes);
        for fault in decoded.faults {
            self.findings.add(&UTF_8, file, fault);
        }
        match xml::parse(&decoded.text) {
            Ok(root) => {
                schema::check(file, &root, schema, self.findings);
                further(self, &root);
            }
            Err(error) => self.findings.add(readable, file, format!("{error:#}")),
        }
        true
    }

    /// Checks that there are sources or binaries, and that each interface type has its binary for each platform.
    fn binaries(&mut self, has_sources: bool) {
        let folders = platform::folders(&self.archive.names).into_iter();
        let folders: BTreeSet<String> = folders.map(str::to_owned).collect();
        let is_empty = |folder: &String| {
            let folder = format!("binaries/{folder}/");
            let mut files = self.archive.names.iter();
            files.all(|name| !name.starts_with(&folder) || *name == folder)
        };
        let (empty, folders): (Vec<_>, Vec<_>) = folders.into_iter().partition(is_empty);
        for folder in empty {
            find!(self.findings, PLATFORM_EMPTY at format!("binaries/{folder}"),
                "it is empty, expected a binary");
        }
        let version = self.model.version;
        require!(self.findings, BINARIES_OR_SOURCES at "archive", has_sources || !folders.is_empty(),
            "it has neither binaries nor sources, expected at least one of the two");
        for folder in folders {
            let place = format!("binaries/{folder}");
            match Platform::named(&folder, version) {
                Err(_) if version == FmiVersion::Fmi3 && is_static(&folder) => {}
                Err(error) => find!(self.findings, KNOWN_PLATFORM at place, "{error}"),
                Ok(platform) => {
                    for identifier in self.identifiers() {
                        let file = platform.binary(identifier);
                        if self.names.contains(&file) {
                            self.binary(&file, identifier, platform);
                        } else {
                            find!(self.findings, BINARY_NAMED at place.as_str(),
                                "it has no {}, expected the binary that modelIdentifier names", quote(&file));
                        }
                    }
                }
            }
        }
    }

    /// Checks a binary of all interface types with this identifier: its format, and which functions of FMI 3.0 it
    /// exports. It is not run, so those for other machines are checked, too.
    fn binary(&mut self, file: &str, identifier: &str, platform: Platform) {
        let head = self.archive.head(file, Platform::HEAD);
        if let Err(error) = head.and_then(|head| platform.check(&head)) {
            return find!(self.findings, BINARY_FORMAT at file, "{error:#}");
        }
        if self.model.version == FmiVersion::Fmi2 {
            return;
        }
        let binary = self.archive.head(file, MAX_BINARY + 1).unwrap_or_default();
        // The names that a binary of macOS exports may be compressed.
        let has_plain_names = binary.starts_with(b"\x7fELF") || binary.starts_with(b"MZ");
        if binary.len() as u64 > MAX_BINARY || !has_plain_names {
            return;
        }
        let is_of = |interface: &str| {
            let mut own = interfaces(self.model.root).filter(|own| own.name == interface);
            own.any(|own| own.attribute("modelIdentifier") == Some(identifier))
        };
        let functions = fmi3::FUNCTIONS.iter().map(|(function, _)| function);
        let required = functions.filter(|function| {
            let instantiates = function.name.strip_prefix("fmi3Instantiate");
            match (instantiates, function.interface) {
                (Some(interface), _) => is_of(interface),
                (None, Interface::All) => true,
                (None, interface) => is_of(&format!("{interface:?}")),
            }
        });
        for name in missing(&binary, required.map(|function| function.name)) {
            find!(self.findings, EXPORTED at file,
                "it does not export {name}, expected all functions of its interface types");
        }
    }

    /// Checks the folders of documentation, icons and further data (FMI 3.0.2, section 2.5.1).
    fn folders(&mut self) {
        const LICENCES: &str = "documentation/licenses/";
        let (names, findings) = (&self.names, &mut *self.findings);
        for image in ["documentation/diagram", "terminalsAndIcons/icon"] {
            let [vector, pixels] = ["svg", "png"].map(|extension| format!("{image}.{extension}"));
            require!(findings, IMAGE_PNG at vector.as_str(),
                names.contains(&pixels) || !names.contains(&vector),
                "it has no {pixels} beside it, expected both");
        }
        let has_one = |base: &str, extensions: &[&str]| {
            let mut extensions = extensions.iter();
            extensions.any(|extension| names.contains(&format!("{base}.{extension}")))
        };
        let files_in = |folder| {
            let files = names.iter().filter(|name| !name.ends_with('/'));
            files.filter(move |name| name.starts_with(folder))
        };
        let has_entry = has_one(&format!("{LICENCES}license"), &["spdx", "txt", "html"]);
        require!(findings, LICENCE_ENTRY at LICENCES,
            has_entry || files_in(LICENCES).next().is_none(),
            "it has no license.txt, license.html or license.spdx, expected one of them");
        let has_page = has_one("documentation/staticLinking", &["txt", "html"]);
        for folder in platform::folders(&self.archive.names) {
            require!(findings, STATIC_LINKING at format!("binaries/{folder}"),
                has_page || !is_static(folder),
                "it holds a static library, expected documentation/staticLinking.txt or .html");
        }
        let folders = files_in("extra/").filter_map(|name| name.split('/').nth(1));
        for folder in folders.collect::<BTreeSet<_>>() {
            require!(findings, EXTRA_DOMAIN at format!("extra/{folder}"), folder.contains('.'),
                "it is {}, expected a subfolder named after a domain, such as com.example", quote(folder));
        }
    }

    /// Checks the sources; returns whether the FMU has any.
    fn sources(&mut self) -> bool {
        let root = self.model.root;
        if self.model.version == FmiVersion::Fmi3 {
            let is_file = |name: &String| name.starts_with("sources/") && !name.ends_with('/');
            if self.names.iter().any(is_file)
                && !self.document(BUILD_FILE, &schema::BUILD, &BUILD_GIVEN, Files::build)
            {
                let has_binaries = self.names.iter().any(|name| name.starts_with("binaries/"));
                let rule = if has_binaries { &SOURCES_LEFT } else { &BUILD_GIVEN };
                let text = format!("it has no {BUILD_FILE}, expected it beside the sources");
                self.findings.add(rule, "sources", text);
            }
            return self.names.contains(BUILD_FILE);
        }
        for kind in INTERFACES {
            let mut listed = HashSet::new();
            let interfaces = root.children(kind);
            for file in interfaces.flat_map(|kind| kind.list("SourceFiles", "File")) {
                if let Some(name) = file.attribute("name") {
                    let path = self.source(name, file.into());
                    require!(self.findings, SOURCES_UNIQUE at file, listed.insert(path),
                        "the source file {} is listed twice, expected once", quote(name));
                }
            }
        }
        interfaces(root).any(|interface| interface.child("SourceFiles").is_some())
    }

    /// Checks that a source file exists; returns its path, or else its name.
    fn source(&mut self, name: &str, at: Location) -> String {
        let path = archive::relative(&format!("sources/{name}"));
        let exists = path.as_ref().is_ok_and(|path| self.names.contains(path));
        require!(self.findings, SOURCES_EXIST at at, exists,
            "the source file {} is missing, expected it in sources", quote(name));
        path.unwrap_or_else(|_| name.to_owned())
    }

    /// Checks `buildDescription.xml`.
    fn build(&mut self, document: &Element<'_>) {
        let at = |element| Location::of(BUILD_FILE, element);
        let identifiers = self.identifiers();
        let mut platforms = HashSet::new();
        for configuration in document.children("BuildConfiguration") {
            let identifier = configuration.attribute("modelIdentifier");
            let identifier = identifier.unwrap_or_default();
            require!(self.findings, BUILD_IDENTIFIER at at(configuration),
                identifiers.contains(identifier),
                "modelIdentifier is {}, expected that of an interface type", quote(identifier));
            let platform = configuration.attribute("platform");
            require!(self.findings, BUILD_PLATFORM at at(configuration),
                platforms.insert((identifier, platform)),
                "two configurations have {}, expected one", platform.map_or("no platform".into(), quote));
            require!(self.findings, BUILD_SOURCES at at(configuration),
                configuration.child("SourceFileSet").is_some(),
                "it has no SourceFileSet, expected one");
            for set in configuration.children("SourceFileSet") {
                self.source_set(set);
            }
        }
    }

    /// Checks a set of source files, and what it is compiled with.
    fn source_set(&mut self, set: &Element<'_>) {
        let at = |element| Location::of(BUILD_FILE, element);
        for kind in ["SourceFile", "PreprocessorDefinition", "IncludeDirectory"] {
            let mut names = HashSet::new();
            for element in set.children(kind) {
                let name = element.attribute("name").unwrap_or_default();
                require!(self.findings, BUILD_ONCE at at(element), names.insert(name),
                    "the {kind} {} appears twice, expected once", quote(name));
            }
        }
        require!(self.findings, BUILD_COMPILER at at(set),
            set.has("compiler") || !set.has("compilerOptions"),
            "it has compilerOptions and no compiler, expected both");
        for definition in set.children("PreprocessorDefinition") {
            if let Some(value) = definition.attribute("value") {
                let mut options = definition.children("Option").peekable();
                let is_free = options.peek().is_none();
                require!(self.findings, BUILD_OPTION at at(definition),
                    is_free || options.any(|option| option.attribute("value") == Some(value)),
                    "value is {}, expected that of an Option", quote(value));
            }
        }
        for file in set.children("SourceFile") {
            self.source(file.attribute("name").unwrap_or_default(), at(file));
        }
    }

    /// Checks `terminalsAndIcons.xml`.
    fn terminals(&mut self, document: &Element<'_>) {
        let at = |element| Location::of(TERMINALS_FILE, element);
        let root = self.model.root;
        let [expected, found] = [root, document].map(|root| root.attribute("fmiVersion"));
        if let (Some(expected), Some(found)) = (expected, found) {
            require!(self.findings, TERMINALS_VERSION at at(document), expected == found,
                "fmiVersion is {}, expected {} as in the model description", quote(found), quote(expected));
        }
        for system in document.list("GraphicalRepresentation", "CoordinateSystem") {
            for (first, second) in [("x1", "x2"), ("y1", "y2")] {
                if let (Some(low), Some(high)) = (system.real(first), system.real(second)) {
                    require!(self.findings, COORDINATES at at(system), low < high,
                        "{first} is {low} and {second} is {high}, expected {first} < {second}");
                }
            }
        }
        let variables = root.child("ModelVariables").into_iter();
        let causalities = variables.flat_map(|list| &list.children).flat_map(|variable| {
            let causality = variable.attribute("causality").unwrap_or("local");
            let elements = [variable].into_iter().chain(variable.children("Alias"));
            elements.filter_map(move |element| Some((element.attribute("name")?, causality)))
        });
        if let Some(terminals) = document.child("Terminals") {
            self.level(terminals, &causalities.collect());
        }
    }

    /// Checks the terminals of one level, and those in them.
    fn level(&mut self, parent: &Element<'_>, causalities: &Causalities<'_>) {
        let mut names = HashSet::new();
        for terminal in parent.children("Terminal") {
            if let Some(name) = terminal.attribute("name") {
                require!(self.findings, TERMINAL_UNIQUE at Location::of(TERMINALS_FILE, terminal),
                    !name.is_empty() && names.insert(name),
                    "the name of the terminal is {}, expected one of its own", quote(name));
            }
            members(terminal, causalities, self.findings);
            for graphical in terminal.children("TerminalGraphicalRepresentation") {
                if let Some(base) = graphical.attribute("iconBaseName") {
                    let path = archive::relative(&format!("{ICONS}/{base}.png"));
                    require!(self.findings, ICON_EXISTS at Location::of(TERMINALS_FILE, graphical),
                        path.is_ok_and(|path| self.names.contains(&path)),
                        "iconBaseName is {}, expected a PNG file of that name in {ICONS}", quote(base));
                }
            }
            self.level(terminal, causalities);
        }
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

/// The causality of each variable and alias, by name.
type Causalities<'a> = HashMap<&'a str, &'a str>;

/// Checks the members of a terminal: that each is a variable with a causality that a member of a known kind may
/// have, and that names are unique if they are matched.
fn members(terminal: &Element<'_>, causalities: &Causalities<'_>, findings: &mut Findings) {
    let at = |element: &Element<'_>| Location::of(TERMINALS_FILE, element);
    let variable = |member: &Element<'_>, attribute, is_known: bool, findings: &mut Findings| {
        let Some(name) = member.attribute(attribute) else { return };
        let shown = quote(name);
        match causalities.get(name) {
            None => find!(findings, MEMBER_EXISTS at at(member),
                "{attribute} is {shown}, expected the name of a variable"),
            Some(causality) => require!(findings, MEMBER_CAUSALITY at at(member),
                !is_known || ["input", "output", "parameter", "calculatedParameter"].contains(causality),
                "{attribute} is {shown} with causality {}, expected input, output, parameter or \
                 calculatedParameter", quote(causality)),
        }
    };
    let is_matched_by_name = matches!(terminal.attribute("matchingRule"), Some("plug" | "bus"));
    let (mut names, mut flows) = (HashSet::new(), 0);
    for member in terminal.children("TerminalMemberVariable") {
        let kind = member.attribute("variableKind").unwrap_or_default();
        let is_flow = matches!(kind, "inflow" | "outflow");
        flows += usize::from(is_flow);
        variable(member, "variableName", is_flow || kind == "signal", findings);
        let name = member.attribute("memberName");
        let is_own = name.is_some_and(|name| !name.is_empty() && names.insert(name));
        require!(findings, MEMBER_NAMED at at(member), is_own || !is_matched_by_name,
            "memberName is {}, expected one of its own", name.map_or("missing".into(), quote));
    }
    for member in terminal.children("TerminalStreamMemberVariable") {
        for (name, of) in [
            ("inStreamMemberName", "inStreamVariableName"),
            ("outStreamMemberName", "outStreamVariableName"),
        ] {
            variable(member, of, true, findings);
            if let Some(name) = member.attribute(name).filter(|_| is_matched_by_name) {
                require!(findings, MEMBER_NAMED at at(member), names.insert(name),
                    "the member name {} appears twice, expected once", quote(name));
            }
        }
        require!(findings, STREAM_FLOW at at(member), flows <= 1,
            "its terminal has {flows} inflows and outflows, expected at most one");
    }
}
