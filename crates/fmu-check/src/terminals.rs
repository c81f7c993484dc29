//! Checks of `terminalsAndIcons/terminalsAndIcons.xml` (FMI 3.0.2, section 2.4.9).

use std::collections::{HashMap, HashSet};

use fmu_description::value::real;
use fmu_description::xml::{self, Element};
use fmu_file::archive::{self, Archive};
use fmu_file::text::quote;

use crate::finding::{Findings, Location};
use crate::package;
use crate::rule::rules;
use crate::schema::{self, terminals::TERMINALS_AND_ICONS};

/// The folder of terminals and icons.
pub const FOLDER: &str = "terminalsAndIcons";
/// The description of terminals.
pub const FILE: &str = "terminalsAndIcons/terminalsAndIcons.xml";

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

/// The causality of each variable and alias, by name.
type Causalities<'a> = HashMap<&'a str, &'a str>;

/// What the terminals refer to.
struct Context<'a> {
    causalities: Causalities<'a>,
    files: &'a HashSet<&'a str>,
}

/// Checks the file, if the FMU has it; `root` is that of the model description.
pub fn check(root: &Element<'_>, archive: &mut Archive, findings: &mut Findings) {
    let Some(text) = package::xml(FILE, archive, findings) else {
        return;
    };
    let document = match xml::parse(&text) {
        Ok(document) => document,
        Err(error) => return findings.add(&TERMINALS_READABLE, FILE, format!("{error:#}")),
    };
    schema::check(FILE, &document, &TERMINALS_AND_ICONS, findings);
    version(root, &document, findings);
    coordinates(&document, findings);
    let files = archive.names.iter().map(String::as_str).collect();
    let context = Context {
        causalities: causalities(root),
        files: &files,
    };
    if let Some(terminals) = document.child("Terminals") {
        level(terminals, &context, findings);
    }
}

fn causalities<'a>(root: &'a Element<'_>) -> Causalities<'a> {
    let mut causalities = Causalities::new();
    for variable in root
        .child("ModelVariables")
        .into_iter()
        .flat_map(|list| &list.children)
    {
        let causality = variable.attribute("causality").unwrap_or("local");
        for element in [variable].into_iter().chain(variable.children("Alias")) {
            if let Some(name) = element.attribute("name") {
                causalities.insert(name, causality);
            }
        }
    }
    causalities
}

fn version(root: &Element<'_>, document: &Element<'_>, findings: &mut Findings) {
    let [expected, found] = [root, document].map(|element| element.attribute("fmiVersion"));
    if let (Some(expected), Some(found)) = (expected, found)
        && expected != found
    {
        let (expected, found) = (quote(expected), quote(found));
        let text =
            format!("fmiVersion is {found}, expected {expected} as in the model description");
        findings.add(&TERMINALS_VERSION, Location::of(FILE, document), text);
    }
}

fn coordinates(document: &Element<'_>, findings: &mut Findings) {
    for system in document.list("GraphicalRepresentation", "CoordinateSystem") {
        for (first, second) in [("x1", "x2"), ("y1", "y2")] {
            let number = |name| system.attribute(name).and_then(real);
            if let (Some(low), Some(high)) = (number(first), number(second))
                && low >= high
            {
                let text =
                    format!("{first} is {low} and {second} is {high}, expected {first} < {second}");
                findings.add(&COORDINATES, Location::of(FILE, system), text);
            }
        }
    }
}

/// Checks the terminals of one level, and those in them.
fn level(parent: &Element<'_>, context: &Context<'_>, findings: &mut Findings) {
    let mut names = HashSet::new();
    for terminal in parent.children("Terminal") {
        if let Some(name) = terminal.attribute("name")
            && (name.is_empty() || !names.insert(name))
        {
            let text = format!(
                "the name of the terminal is {}, expected one of its own",
                quote(name)
            );
            findings.add(&TERMINAL_UNIQUE, Location::of(FILE, terminal), text);
        }
        members(terminal, context, findings);
        icon(terminal, context, findings);
        level(terminal, context, findings);
    }
}

/// Attributes of the members of a stream: those with member names, and those with variables.
const STREAM: [(&str, &str); 2] = [
    ("inStreamMemberName", "inStreamVariableName"),
    ("outStreamMemberName", "outStreamVariableName"),
];

fn members(terminal: &Element<'_>, context: &Context<'_>, findings: &mut Findings) {
    let is_matched_by_name = matches!(terminal.attribute("matchingRule"), Some("plug" | "bus"));
    let mut names = HashSet::new();
    let mut flows = 0;
    for member in terminal.children("TerminalMemberVariable") {
        let kind = member.attribute("variableKind").unwrap_or_default();
        let is_known = matches!(kind, "signal" | "inflow" | "outflow");
        flows += usize::from(matches!(kind, "inflow" | "outflow"));
        variable(member, "variableName", is_known, context, findings);
        let name = member.attribute("memberName");
        if is_matched_by_name && name.is_none_or(|name| name.is_empty() || !names.insert(name)) {
            let name = name.map_or("missing".into(), quote);
            let text = format!("memberName is {name}, expected one of its own");
            findings.add(&MEMBER_NAMED, Location::of(FILE, member), text);
        }
    }
    for member in terminal.children("TerminalStreamMemberVariable") {
        for (name, of) in STREAM {
            variable(member, of, true, context, findings);
            if is_matched_by_name
                && let Some(name) = member.attribute(name)
                && !names.insert(name)
            {
                let text = format!(
                    "the member name {} appears twice, expected once",
                    quote(name)
                );
                findings.add(&MEMBER_NAMED, Location::of(FILE, member), text);
            }
        }
        if flows > 1 {
            let text =
                format!("its terminal has {flows} inflows and outflows, expected at most one");
            findings.add(&STREAM_FLOW, Location::of(FILE, member), text);
        }
    }
}

/// Checks that a member is a variable that can be connected.
fn variable(
    member: &Element<'_>,
    attribute: &str,
    is_connected: bool,
    context: &Context<'_>,
    findings: &mut Findings,
) {
    let Some(name) = member.attribute(attribute) else {
        return;
    };
    let at = Location::of(FILE, member);
    match context.causalities.get(name) {
        None => {
            let text = format!(
                "{attribute} is {}, expected the name of a variable",
                quote(name)
            );
            findings.add(&MEMBER_EXISTS, at, text);
        }
        Some(causality)
            if is_connected
                && !["input", "output", "parameter", "calculatedParameter"].contains(causality) =>
        {
            let text = format!(
                "{attribute} is {} with causality {}, expected input, output, parameter or calculatedParameter",
                quote(name),
                quote(causality)
            );
            findings.add(&MEMBER_CAUSALITY, at, text);
        }
        Some(_) => {}
    }
}

fn icon(terminal: &Element<'_>, context: &Context<'_>, findings: &mut Findings) {
    for graphical in terminal.children("TerminalGraphicalRepresentation") {
        let Some(base) = graphical.attribute("iconBaseName") else {
            continue;
        };
        let path = archive::relative(&format!("{FOLDER}/{base}.png"));
        if !path.is_ok_and(|path| context.files.contains(path.as_str())) {
            let text = format!(
                "iconBaseName is {}, expected a PNG file of that name in {FOLDER}",
                quote(base)
            );
            findings.add(&ICON_EXISTS, Location::of(FILE, graphical), text);
        }
    }
}
