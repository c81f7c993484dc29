//! Checks of `terminalsAndIcons/terminalsAndIcons.xml` (FMI 3.0.2, section 2.4.9).

use std::collections::{HashMap, HashSet};

use fmu_description::ModelDescription;
use fmu_description::xml::{self, Element};
use fmu_file::archive::{self, Archive};
use fmu_file::text::quote;

use crate::finding::{Findings, Location, find, require};
use crate::rule::rules;
use crate::{package, schema};

const FOLDER: &str = "terminalsAndIcons";
const FILE: &str = "terminalsAndIcons/terminalsAndIcons.xml";

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
pub fn check(model: &ModelDescription<'_>, archive: &mut Archive, findings: &mut Findings) {
    let Some(text) = package::xml(FILE, archive, findings) else {
        return;
    };
    let document = match xml::parse(&text) {
        Ok(document) => document,
        Err(error) => return find!(findings, TERMINALS_READABLE at FILE, "{error:#}"),
    };
    schema::check(FILE, &document, &schema::TERMINALS, findings);
    let [expected, found] = [model.root, &document].map(|root| root.attribute("fmiVersion"));
    if let (Some(expected), Some(found)) = (expected, found) {
        require!(findings, TERMINALS_VERSION at Location::of(FILE, &document), expected == found,
            "fmiVersion is {}, expected {} as in the model description", quote(found), quote(expected));
    }
    for system in document.list("GraphicalRepresentation", "CoordinateSystem") {
        for (first, second) in [("x1", "x2"), ("y1", "y2")] {
            if let (Some(low), Some(high)) = (system.real(first), system.real(second)) {
                require!(findings, COORDINATES at Location::of(FILE, system), low < high,
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
            require!(findings, TERMINAL_UNIQUE at Location::of(FILE, terminal),
                !name.is_empty() && names.insert(name),
                "the name of the terminal is {}, expected one of its own", quote(name));
        }
        members(terminal, context, findings);
        for graphical in terminal.children("TerminalGraphicalRepresentation") {
            if let Some(base) = graphical.attribute("iconBaseName") {
                let path = archive::relative(&format!("{FOLDER}/{base}.png"));
                let exists = path.is_ok_and(|path| context.files.contains(path.as_str()));
                require!(findings, ICON_EXISTS at Location::of(FILE, graphical), exists,
                    "iconBaseName is {}, expected a PNG file of that name in {FOLDER}", quote(base));
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
        variable(member, "variableName", is_known, context, findings);
        let name = member.attribute("memberName");
        let is_own = name.is_some_and(|name| !name.is_empty() && names.insert(name));
        require!(findings, MEMBER_NAMED at Location::of(FILE, member), is_own || !is_matched_by_name,
            "memberName is {}, expected one of its own", name.map_or("missing".into(), quote));
    }
    for member in terminal.children("TerminalStreamMemberVariable") {
        for (name, of) in [
            ("inStreamMemberName", "inStreamVariableName"),
            ("outStreamMemberName", "outStreamVariableName"),
        ] {
            variable(member, of, true, context, findings);
            if let Some(name) = member.attribute(name).filter(|_| is_matched_by_name) {
                require!(findings, MEMBER_NAMED at Location::of(FILE, member), names.insert(name),
                    "the member name {} appears twice, expected once", quote(name));
            }
        }
        require!(findings, STREAM_FLOW at Location::of(FILE, member), flows <= 1,
            "its terminal has {flows} inflows and outflows, expected at most one");
    }
}

/// Checks that an attribute names a variable, which has a causality that a member of a known kind may have.
fn variable(
    member: &Element<'_>,
    attribute: &str,
    is_known: bool,
    context: &Context<'_>,
    findings: &mut Findings,
) {
    let Some(name) = member.attribute(attribute) else {
        return;
    };
    let (at, shown) = (Location::of(FILE, member), quote(name));
    match context.causalities.get(name) {
        None => find!(findings, MEMBER_EXISTS at at,
            "{attribute} is {shown}, expected the name of a variable"),
        Some(causality) => require!(findings, MEMBER_CAUSALITY at at,
            !is_known || ["input", "output", "parameter", "calculatedParameter"].contains(causality),
            "{attribute} is {shown} with causality {}, expected input, output, parameter or \
             calculatedParameter", quote(causality)),
    }
}
