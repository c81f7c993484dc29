//! Checks of the archive and of the files that it must contain: binaries, folders, and
//! `terminalsAndIcons/terminalsAndIcons.xml` (FMI 3.0.2, section 2.4.9).

use std::collections::{BTreeSet, HashMap, HashSet};

use fmi_abi::{FunctionGroup, fmi3};
use fmu_description::xml::{self, Element};
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::{self, Archive, TERMINALS};
use fmu_file::platform::{self, Platform};
use fmu_file::text::quote;

use crate::bus;
use crate::finding::{Findings, Location, find, require};
use crate::rule::{Rule, rule};
use crate::schema::{self, Schema};

/// Names of the interface types.
pub const INTERFACES: [&str; 3] = ["ModelExchange", "CoSimulation", "ScheduledExecution"];

/// Larger binaries are not read.
const MAX_BINARY: u64 = 128 << 20;
/// Maximum number of bytes that are read of an XML file.
const MAX_XML: u64 = 64 << 20;
const ICONS: &str = "terminalsAndIcons";

/// Checks that the archive can be unpacked.
pub fn check(archive: &mut Archive, findings: &mut Findings) {
    for fault in &archive.faults {
        findings.add(rule!("archive-safe"), "archive", fault);
    }
    for oddity in &archive.oddities {
        findings.add(rule!("archive-plain"), "archive", oddity);
    }
    for name in &archive.dotted {
        findings.add(rule!("archive-names"), "archive", name);
    }
    // Files that are too large must not be inflated.
    if archive.faults.is_empty() {
        for damage in archive.damages() {
            findings.add(rule!("files-intact"), "archive", damage);
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
        files.document(
            TERMINALS,
            &schema::TERMINALS,
            rule!("terminals-readable"),
            Files::terminals,
        );
        files.document(
            bus::MANIFEST,
            &schema::LAYERED,
            rule!("bus-manifest-readable"),
            |files, root| bus::manifest(root, files.findings),
        );
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
pub struct Files<'a> {
    pub model: &'a ModelDescription<'a>,
    pub names: HashSet<String>,
    pub archive: &'a mut Archive,
    pub findings: &'a mut Findings,
}

impl<'a> Files<'a> {
    /// The identifiers of the interface types, which are names of binaries.
    pub fn identifiers(&self) -> BTreeSet<&'a str> {
        let identifiers = interfaces(self.model.root);
        identifiers.filter_map(|of| of.attribute("modelIdentifier")).collect()
    }

    /// Checks an XML file against its schema, and applies further checks; returns whether it exists. Its damage
    /// is reported by [`check`].
    pub fn document(
        &mut self,
        file: &str,
        schema: &Schema,
        readable: &'static Rule,
        further: impl FnOnce(&mut Self, &Element<'_>),
    ) -> bool {
        let Ok(bytes) = self.archive.head(file, MAX_XML) else { return false };
        let decoded = xml::decode(&bytes);
        for fault in decoded.faults {
            self.findings.add(rule!("utf-8"), file, fault);
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
            find!(self.findings, "platform-empty" at format!("binaries/{folder}"),
                "it is empty, expected a binary");
        }
        let version = self.model.version;
        require!(self.findings, "binaries-or-sources" at "archive", has_sources || !folders.is_empty(),
            "it has neither binaries nor sources, expected at least one of the two");
        for folder in folders {
            let place = format!("binaries/{folder}");
            match Platform::named(&folder, version) {
                Err(_) if version == FmiVersion::Fmi3 && is_static(&folder) => {}
                Err(error) => find!(self.findings, "platform-known" at place, "{error}"),
                Ok(platform) => {
                    for identifier in self.identifiers() {
                        let file = platform.binary(identifier);
                        if self.names.contains(&file) {
                            self.binary(&file, identifier, platform);
                        } else {
                            find!(self.findings, "binary-named" at place.as_str(),
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
            return find!(self.findings, "binary-format" at file, "{error:#}");
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
            match (instantiates, function.group) {
                (Some(interface), _) => is_of(interface),
                (None, FunctionGroup::All | FunctionGroup::Clocks) => true,
                (None, group) => is_of(&format!("{group:?}")),
            }
        });
        for name in missing(&binary, required.map(|function| function.name)) {
            find!(self.findings, "functions-exported" at file,
                "it does not export {name}, expected all functions of its interface types");
        }
    }

    /// Checks the folders of documentation, icons and further data (FMI 3.0.2, section 2.5.1).
    fn folders(&mut self) {
        const LICENCES: &str = "documentation/licenses/";
        let (names, findings) = (&self.names, &mut *self.findings);
        for image in ["documentation/diagram", "terminalsAndIcons/icon"] {
            let [vector, pixels] = ["svg", "png"].map(|extension| format!("{image}.{extension}"));
            require!(findings, "image-png" at vector.as_str(),
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
        require!(findings, "licence-entry" at LICENCES,
            has_entry || files_in(LICENCES).next().is_none(),
            "it has no license.txt, license.html or license.spdx, expected one of them");
        let has_page = has_one("documentation/staticLinking", &["txt", "html"]);
        for folder in platform::folders(&self.archive.names) {
            require!(findings, "static-linking" at format!("binaries/{folder}"),
                has_page || !is_static(folder),
                "it holds a static library, expected documentation/staticLinking.txt or .html");
        }
        let entries = files_in("extra/").filter_map(|name| {
            let mut parts = name.split('/').skip(1);
            Some((parts.next()?, parts.next().is_some()))
        });
        for (entry, is_folder) in entries.collect::<BTreeSet<_>>() {
            require!(findings, "extra-domain" at format!("extra/{entry}"),
                is_folder && entry.contains('.'),
                "it is {}, expected a subfolder named after a domain, such as com.example", quote(entry));
        }
    }

    /// Checks `terminalsAndIcons.xml`.
    fn terminals(&mut self, document: &Element<'_>) {
        let at = |element| Location::in_file(TERMINALS, element);
        let root = self.model.root;
        let [expected, found] = [root, document].map(|root| root.attribute("fmiVersion"));
        if let (Some(expected), Some(found)) = (expected, found) {
            require!(self.findings, "terminals-version" at at(document), expected == found,
                "fmiVersion is {}, expected {} as in the model description", quote(found), quote(expected));
        }
        for system in document.list("GraphicalRepresentation", "CoordinateSystem") {
            for (first, second) in [("x1", "x2"), ("y1", "y2")] {
                if let (Some(low), Some(high)) = (system.real(first), system.real(second)) {
                    require!(self.findings, "coordinates" at at(system), low < high,
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
            let has_manifest = self.names.contains(bus::MANIFEST);
            bus::terminals(self.model, terminals, has_manifest, self.findings);
        }
    }

    /// Checks the terminals of one level, and those in them.
    fn level(&mut self, parent: &Element<'_>, causalities: &Causalities<'_>) {
        let mut names = HashSet::new();
        for terminal in parent.children("Terminal") {
            if let Some(name) = terminal.attribute("name") {
                require!(self.findings, "terminal-unique" at Location::in_file(TERMINALS, terminal),
                    !name.is_empty() && names.insert(name),
                    "the name of the terminal is {}, expected a unique, non-empty name", quote(name));
            }
            members(terminal, causalities, self.findings);
            for graphical in terminal.children("TerminalGraphicalRepresentation") {
                if let Some(base) = graphical.attribute("iconBaseName") {
                    let path = archive::relative(&format!("{ICONS}/{base}.png"));
                    require!(self.findings, "icon-exists" at Location::in_file(TERMINALS, graphical),
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
    let at = |element: &Element<'_>| Location::in_file(TERMINALS, element);
    let variable = |member: &Element<'_>, attribute, is_known: bool, findings: &mut Findings| {
        let Some(name) = member.attribute(attribute) else { return };
        let shown = quote(name);
        match causalities.get(name) {
            None => find!(findings, "member-exists" at at(member),
                "{attribute} is {shown}, expected the name of a variable"),
            Some(causality) => require!(findings, "member-causality" at at(member),
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
        require!(findings, "member-named" at at(member), is_own || !is_matched_by_name,
            "memberName is {}, expected a unique, non-empty name", name.map_or("missing".into(), quote));
    }
    for member in terminal.children("TerminalStreamMemberVariable") {
        for (name, of) in [
            ("inStreamMemberName", "inStreamVariableName"),
            ("outStreamMemberName", "outStreamVariableName"),
        ] {
            variable(member, of, true, findings);
            if let Some(name) = member.attribute(name).filter(|_| is_matched_by_name) {
                require!(findings, "member-named" at at(member), names.insert(name),
                    "the member name {} appears twice, expected once", quote(name));
            }
        }
        require!(findings, "stream-flow" at at(member), flows <= 1,
            "its terminal has {flows} inflows and outflows, expected at most one");
    }
}
