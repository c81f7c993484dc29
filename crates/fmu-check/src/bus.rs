//! Checks of what an FMU has by the layered standard FMI-LS-BUS 1.0.0: the manifest, and the terminals of networks.

use std::collections::HashMap;
use std::sync::LazyLock;

use fmi_ls_bus::{Frame, Id, Operation, operations};
use fmu_description::value::{boolean, items, whole};
use fmu_description::xml::Element;
use fmu_description::{Causality, ModelDescription, Type, XmlVariable};
use fmu_file::archive::TERMINALS;
use fmu_file::text::quote;
use regex_lite::Regex;

use crate::finding::{Findings, Location, find, require};
use crate::schema::anchored;

/// The manifest.
pub use fmu_file::archive::BUS_MANIFEST as MANIFEST;
/// The MIME type of operations on a network of CAN, without its version.
pub const CAN: &str = "application/org.fmi-standard.fmi-ls-bus.can";

const NETWORK: &str = "org.fmi-ls-bus.network-terminal";
const CONFIGURATION: &str = "org.fmi-ls-bus.network-terminal.configuration";

static VERSION: LazyLock<Regex> = LazyLock::new(|| anchored(r"[0-9]+\.[0-9]+\.[0-9]+(-.+)?"));
static MIME_TYPE: LazyLock<Regex> = LazyLock::new(|| {
    let version = r#""[0-9]+\.[0-9]+\.[0-9]+(-[^"]+)?""#;
    let bus = r"application/org\.fmi-standard\.fmi-ls-bus\.[a-z0-9-]+";
    anchored(&format!("{bus}; *version={version}"))
});

/// Checks the attributes of the manifest.
pub fn manifest(root: &Element<'_>, findings: &mut Findings) {
    let at = || Location::in_file(MANIFEST, root);
    // The prefix of the namespace is not fixed.
    let attribute = |name: &str| {
        let mut all = root.attributes.iter();
        all.find(|(key, _)| key.rsplit(':').next() == Some(name)).map(|(_, value)| value.as_ref())
    };
    let shown = |value: Option<&str>| value.map_or("missing".into(), quote);
    for (name, fits, expected) in [
        (
            "fmi-ls-name",
            (|name| name == "org.fmi-standard.fmi-ls-bus") as fn(&str) -> bool,
            "org.fmi-standard.fmi-ls-bus",
        ),
        ("fmi-ls-version", |version| VERSION.is_match(version), "a version such as 1.0.0"),
        ("fmi-ls-description", |text| !text.trim().is_empty(), "a text"),
    ] {
        let value = attribute(name);
        require!(findings, "bus-manifest" at at(), value.is_some_and(fits),
            "{name} is {}, expected {expected}", shown(value));
    }
    let flag = attribute("isBusSimulationFMU");
    require!(findings, "bus-manifest" at at(), flag.is_none_or(|flag| boolean(flag).is_some()),
        "isBusSimulationFMU is {}, expected true or false", shown(flag));
}

/// Whether a Binary holds operations on a network of CAN.
fn is_can(variable: &XmlVariable<'_>) -> bool {
    let mime_type = variable.mime_type.as_deref().unwrap_or_default();
    mime_type.split(';').next().is_some_and(|kind| kind.trim() == CAN)
}

/// A frame that a network of CAN may transmit to a variable.
pub fn frame(variable: &XmlVariable<'_>, point: usize) -> Option<Vec<u8>> {
    let data = (point as u64).to_le_bytes();
    let frame = Frame::can(Id::Standard((point % 0x7ff) as u16), &data);
    let (mut bytes, max) = (Vec::new(), variable.max_size.unwrap_or(usize::MAX));
    Operation::Transmit(frame).append(&mut bytes, max).ok().filter(|()| is_can(variable))?;
    Some(bytes)
}

/// What is wrong with the operations of a variable, if it holds operations on a network of CAN.
pub fn malformed(variable: &XmlVariable<'_>, bytes: &[u8]) -> Option<String> {
    let mut all = operations(bytes).filter(|_| is_can(variable));
    all.find_map(|operation| operation.err().map(|error| error.to_string()))
}

/// A check of terminals.
struct Network<'a> {
    variables: HashMap<&'a str, &'a XmlVariable<'a>>,
    /// The variables that are members, with their terminals.
    members: HashMap<&'a str, &'a str>,
    findings: &'a mut Findings,
}

/// Checks the terminals of networks; `has_manifest` tells whether the FMU has one for them.
pub fn terminals<'a>(
    model: &'a ModelDescription<'a>,
    terminals: &'a Element<'a>,
    has_manifest: bool,
    findings: &'a mut Findings,
) {
    let variables = model.variables().flat_map(|(_, v)| v.names().map(move |name| (name, v)));
    let (variables, members) = (variables.collect(), HashMap::new());
    let mut network = Network { variables, members, findings };
    if !network.level(terminals) {
        return;
    }
    let Network { findings, members, .. } = network;
    require!(findings, "bus-manifest-given" at TERMINALS, has_manifest,
        "it has a network terminal, expected the file {MANIFEST} in the FMU");
    let has_time_based = members.keys().any(|name| {
        let mut clocks = model.variables().filter(|(_, v)| v.of_type == Type::Clock);
        let clock = clocks.find(|(_, v)| v.names().any(|own| own == *name));
        clock.is_some_and(|(_, v)| v.inherited("intervalVariability") != Some("triggered"))
    });
    if let Some(interface) = model.co_simulation() {
        require!(findings, "bus-steps" at interface,
            !has_time_based || interface.is_true("canHandleVariableCommunicationStepSize"),
            "the FMU sends at the ticks of a time-based clock, expected \
             canHandleVariableCommunicationStepSize = true");
    }
}

impl<'a> Network<'a> {
    /// Checks the terminals of one level, and those in them; returns whether one is of a network.
    fn level(&mut self, parent: &'a Element<'a>) -> bool {
        let mut has_one = false;
        for terminal in parent.children("Terminal") {
            if terminal.attribute("terminalKind") == Some(NETWORK) {
                self.terminal(terminal);
                has_one = true;
            } else if self.level(terminal) {
                let rule = terminal.attribute("matchingRule").unwrap_or_default();
                require!(self.findings, "bus-nested" at at(terminal), rule == "none",
                    "the terminal groups network terminals and has matchingRule {}, expected none",
                    quote(rule));
                has_one = true;
            }
        }
        has_one
    }

    /// Checks the terminal of a network.
    fn terminal(&mut self, terminal: &'a Element<'a>) {
        const RULE: &str = "org.fmi-ls-bus.transceiver";
        let name = terminal.attribute("name").unwrap_or_default();
        let rule = terminal.attribute("matchingRule").unwrap_or_default();
        require!(self.findings, "bus-terminal" at at(terminal), rule == RULE,
            "the network terminal has matchingRule {}, expected {RULE}", quote(rule));
        for member in terminal.children("TerminalMemberVariable") {
            let role = member.attribute("memberName").unwrap_or_default();
            let kind = member.attribute("variableKind").unwrap_or_default();
            require!(self.findings, "bus-terminal" at at(member),
                ["Tx_Data", "Tx_Clock", "Rx_Data", "Rx_Clock"].contains(&role) && kind == "signal",
                "the member {} has variableKind {}, expected a signal named Tx_Data, Tx_Clock, Rx_Data \
                 or Rx_Clock", quote(role), quote(kind));
            let Some(variable) = member.attribute("variableName") else { continue };
            if let Some(other) = self.members.insert(variable, name) {
                find!(self.findings, "bus-once" at at(member),
                    "{} is a member of the network terminal {}, too, expected it in one", quote(variable),
                    quote(other));
            }
        }
        let mut mime_types = Vec::new();
        for (data, clock, causality) in
            [("Tx_Data", "Tx_Clock", Causality::Output), ("Rx_Data", "Rx_Clock", Causality::Input)]
        {
            let [data, clock] = [data, clock].map(|role| self.member(terminal, role));
            if let Some((at, data)) = data {
                require!(self.findings, "bus-variables" at at.clone(),
                    data.of_type == Type::Binary && data.causality == causality,
                    "{} is a {} with causality {}, expected a Binary with causality {}",
                    quote(&data.name), data.value.name, data.causality.as_str(), causality.as_str());
                let clocks = data.element.attribute("clocks").unwrap_or_default();
                require!(self.findings, "bus-variables" at at.clone(),
                    clock.as_ref().is_none_or(|(_, clock)| {
                        items(clocks).any(|item| whole(item) == Some(clock.reference))
                    }),
                    "{} does not have the clock of its terminal, expected it in clocks", quote(&data.name));
                let mime_type = data.inherited("mimeType").unwrap_or_default();
                require!(self.findings, "bus-mime-type" at at, MIME_TYPE.is_match(mime_type),
                    "{} has the MIME type {}, expected one such as {CAN}; version=\"1.0.0\"",
                    quote(&data.name), quote(mime_type));
                mime_types.push(mime_type);
            }
            if let Some((at, clock)) = clock {
                let kind = clock.inherited("intervalVariability").unwrap_or_default();
                let is_triggered_input = clock.causality == Causality::Input && kind == "triggered";
                let fits = clock.of_type == Type::Clock
                    && is_triggered_input == (causality == Causality::Input);
                let expected = match causality {
                    Causality::Input => "a triggered input clock",
                    _ => "a time-based input clock or a triggered output clock",
                };
                require!(self.findings, "bus-variables" at at, fits,
                    "{} is a {} with causality {} and intervalVariability {}, expected {expected}",
                    quote(&clock.name), clock.value.name, clock.causality.as_str(), quote(kind));
            }
        }
        if let [sent, received] = mime_types[..] {
            require!(self.findings, "bus-mime-type" at at(terminal), sent == received,
                "Tx_Data has the MIME type {} and Rx_Data {}, expected the same", quote(sent), quote(received));
        }
        for nested in terminal.children("Terminal") {
            let [name, kind, rule] = ["name", "terminalKind", "matchingRule"]
                .map(|name| nested.attribute(name).unwrap_or_default());
            require!(self.findings, "bus-nested" at at(nested),
                (name, kind, rule) == ("Configuration", CONFIGURATION, "bus"),
                "the terminal in a network terminal has name {}, terminalKind {} and matchingRule {}, \
                 expected Configuration, {CONFIGURATION} and bus", quote(name), quote(kind), quote(rule));
        }
    }

    /// The place and the variable of the member with a role, if there is one.
    fn member(
        &mut self,
        terminal: &Element<'_>,
        role: &str,
    ) -> Option<(Location, &'a XmlVariable<'a>)> {
        let mut members = terminal.children("TerminalMemberVariable");
        let member = members.find(|member| member.attribute("memberName") == Some(role));
        let Some(member) = member else {
            find!(self.findings, "bus-terminal" at at(terminal),
                "the network terminal has no member {role}, expected one");
            return None;
        };
        // Another rule finds names of no variable.
        let variable = self.variables.get(member.attribute("variableName")?)?;
        Some((at(member), variable))
    }
}

fn at(element: &Element<'_>) -> Location {
    Location::in_file(TERMINALS, element)
}
