//! Terminals and icons of FMI 3.0, and what FMI-LS-BUS adds to them.

use anyhow::{Result, ensure};

use crate::FmiVersion;
use crate::exported::ExportedModel;
use crate::variable::Variable;
use crate::xml::Element;

/// Corners of the icon and of the coordinate system that it fills.
const CORNERS: [(&str, i32); 4] = [("x1", -100), ("y1", -100), ("x2", 100), ("y2", 100)];

impl ExportedModel {
    /// Generates `terminalsAndIcons.xml` of FMI 3.0; `None` if there is neither a terminal nor an icon.
    /// Two terminals match if they have members of the same names; those of networks are crossed.
    ///
    /// # Errors
    /// Two members of a terminal have the same name, or a member of the terminal of a network is missing.
    pub fn terminals(&self, has_icon: bool) -> Result<Option<Element<'static>>> {
        let mut terminals: Vec<Element<'static>> = Vec::new();
        for variable in &self.variables {
            let Some((name, member)) = variable.exported.terminal.split_once('.') else { continue };
            let index = match terminals.iter().position(|t| t.attribute("name") == Some(name)) {
                Some(index) => index,
                None => {
                    let terminal = Element::new("Terminal").with("name", name);
                    terminals.push(terminal.with("matchingRule", "plug"));
                    terminals.len() - 1
                }
            };
            let members = &mut terminals[index].children;
            ensure!(
                members.iter().all(|other| other.attribute("memberName") != Some(member)),
                "two variables of {} are the member {member} of the terminal {name}; expected different members",
                self.name
            );
            members.push(signal(variable, member));
        }
        terminals.extend(self.networks()?);
        let is_empty = terminals.is_empty() && !has_icon;
        let root = Element::new("fmiTerminalsAndIcons")
            .with("fmiVersion", FmiVersion::Fmi3.as_str())
            .holding_all(has_icon.then(graphics))
            .listing("Terminals", terminals);
        Ok((!is_empty).then_some(root))
    }
}

/// The attributes of the manifest of FMI-LS-BUS; see its schema.
const BUS_MANIFEST: [(&str, &str); 4] = [
    ("xmlns:fmi-ls", "http://fmi-standard.org/fmi-ls-manifest"),
    ("fmi-ls:fmi-ls-name", "org.fmi-standard.fmi-ls-bus"),
    ("fmi-ls:fmi-ls-version", "1.0.0"),
    (
        "fmi-ls:fmi-ls-description",
        "Layered Standard for the simulation of bus communication on a Physical Signal Abstraction or Network Abstraction based level.",
    ),
];
/// What the name of a parameter in the configuration of a network begins with.
const CONFIGURATION: &str = "Configuration.";

/// Networks, by FMI-LS-BUS 1.0.0.
impl ExportedModel {
    /// The manifest of FMI-LS-BUS, if the model has the terminal of a network.
    pub fn bus_manifest(&self) -> Option<Element<'static>> {
        let has_network = self.variables.iter().any(|v| v.exported.network.is_some());
        has_network.then(|| {
            let root = Element::new("fmiLayeredStandardManifest");
            let root = BUS_MANIFEST.iter().fold(root, |root, (name, value)| root.with(name, value));
            root.with("isBusSimulationFMU", self.is_bus_simulation)
        })
    }

    /// The terminals of networks, in the order of their first variables.
    fn networks(&self) -> Result<Vec<Element<'static>>> {
        let mut networks: Vec<(&str, Vec<(&Variable, &str)>)> = Vec::new();
        for variable in &self.variables {
            let Some((name, member)) = &variable.exported.network else { continue };
            match networks.iter_mut().find(|(known, _)| known == name) {
                Some((_, members)) => members.push((variable, member)),
                None => networks.push((name, vec![(variable, member)])),
            }
        }
        networks.into_iter().map(|(name, members)| self.network(name, &members)).collect()
    }

    /// The terminal of a network, from its variables and their names in it.
    fn network(&self, name: &str, members: &[(&Variable, &str)]) -> Result<Element<'static>> {
        for role in ["Rx_Data", "Rx_Clock", "Tx_Data", "Tx_Clock"] {
            let count = members.iter().filter(|(_, member)| *member == role).count();
            ensure!(
                count == 1,
                "{count} variables of {} are the member {role} of the network {name}; expected one, by the option `network = {role:?}`",
                self.name
            );
        }
        let terminal = |name, kind, rule| {
            let terminal = Element::new("Terminal").with("name", name);
            terminal.with("matchingRule", rule).with("terminalKind", kind)
        };
        let signals = members.iter().filter(|(_, member)| !member.starts_with(CONFIGURATION));
        let parameters =
            members.iter().filter_map(|(v, member)| Some((v, member.strip_prefix(CONFIGURATION)?)));
        let parameters = parameters.map(|(v, member)| signal(v, member));
        let kind = "org.fmi-ls-bus.network-terminal.configuration";
        // Also without parameters: the FMU Manipulation Toolbox looks for the one of the other terminal.
        let configuration = terminal(CONFIGURATION.trim_end_matches('.'), kind, "bus");
        Ok(terminal(name, "org.fmi-ls-bus.network-terminal", "org.fmi-ls-bus.transceiver")
            .holding_all(signals.map(|(v, member)| signal(v, member)))
            .holding(configuration.holding_all(parameters)))
    }
}

/// A variable as the member of a terminal.
fn signal(variable: &Variable, member: &str) -> Element<'static> {
    Element::new("TerminalMemberVariable")
        .with("variableName", &variable.name)
        .with("memberName", member)
        .with("variableKind", "signal")
}

fn graphics() -> Element<'static> {
    let corners = |name| {
        let element = Element::new(name);
        CORNERS.iter().fold(element, |element, (name, value)| element.with(name, value))
    };
    Element::new("GraphicalRepresentation")
        .holding(corners("CoordinateSystem").with("suggestedScalingFactorTo_mm", 0.1))
        .holding(corners("Icon"))
}
