//! Terminals of FMUs (FMI 3.0.2, section 2.4.9), two of which a connection of a system may connect.

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::{self, Element};
use fmu_file::archive::TERMINALS;

/// A terminal.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Terminal {
    /// Its name; of a terminal in another one, `outer.inner`.
    pub(crate) name: String,
    matching_rule: String,
    /// The names of members, and of their variables.
    members: Vec<(String, String)>,
}

/// The matching rule of networks (FMI-LS-BUS 1.0.0, section 5.4.1): what one sends, the other receives.
const TRANSCEIVER: &str = "org.fmi-ls-bus.transceiver";

/// Reads the terminals of an FMU.
///
/// # Errors
/// The text is not well-formed.
pub(crate) fn read(text: &str) -> Result<Vec<Terminal>> {
    let root = xml::parse(text).context(TERMINALS)?;
    let mut all = Vec::new();
    root.list("Terminals", "Terminal").for_each(|terminal| add(terminal, "", &mut all));
    Ok(all)
}

fn add(terminal: &Element<'_>, outer: &str, all: &mut Vec<Terminal>) {
    let text = |element: &Element<'_>, name| element.attribute(name).unwrap_or_default().to_owned();
    let name = format!("{outer}{}", text(terminal, "name"));
    let children = |name: &'static str| terminal.children.iter().filter(move |c| c.name == name);
    let members = children("TerminalMemberVariable");
    let members = members.map(|member| (text(member, "memberName"), text(member, "variableName")));
    let (matching_rule, members) = (text(terminal, "matchingRule"), members.collect());
    children("Terminal").for_each(|inner| add(inner, &format!("{name}."), all));
    all.push(Terminal { name, matching_rule, members });
}

impl Terminal {
    /// Whether it is the terminal of a network.
    pub(crate) fn is_network(&self) -> bool {
        self.matching_rule == TRANSCEIVER
    }

    /// The names of its variables.
    pub(crate) fn variables(&self) -> impl Iterator<Item = &str> {
        self.members.iter().map(|(_, variable)| &**variable)
    }

    /// The variables of this terminal and of another one that are connected with each other, in any direction.
    ///
    /// # Errors
    /// The terminals do not match.
    pub(crate) fn pairs<'a>(&'a self, other: &'a Self) -> Result<Vec<(&'a str, &'a str)>> {
        let rule = &*self.matching_rule;
        let different = &*other.matching_rule;
        ensure!(
            rule == different,
            "the terminals have different matching rules: {rule} and {different}"
        );
        let partner = |member: &str| match (rule, member.split_once('_')) {
            (TRANSCEIVER, Some(("Tx", rest))) => format!("Rx_{rest}"),
            (TRANSCEIVER, Some(("Rx", rest))) => format!("Tx_{rest}"),
            _ => member.to_owned(),
        };
        let is_strict = match rule {
            "plug" | TRANSCEIVER => true,
            "bus" => false,
            _ => bail!(
                "the matching rule {rule} is not supported; expected plug, bus or {TRANSCEIVER}"
            ),
        };
        let find = |name: &str| other.members.iter().find(|(member, _)| member == name);
        let pair = |(member, variable): &'a (String, String)| match find(&partner(member)) {
            Some((_, theirs)) => Ok(Some((&**variable, &**theirs))),
            None if is_strict => bail!("the other terminal has no {}", partner(member)),
            None => Ok(None),
        };
        let pairs: Vec<_> = self
            .members
            .iter()
            .filter_map(|member| pair(member).transpose())
            .collect::<Result<_>>()?;
        let (own, theirs) = (self.members.len(), other.members.len());
        ensure!(
            !is_strict || own == theirs,
            "the terminals have {own} and {theirs} members; expected as many"
        );
        ensure!(!pairs.is_empty(), "the terminals have no members in common");
        Ok(pairs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terminal(rule: &str, members: &[(&str, &str)]) -> Terminal {
        let owned = |(member, variable): &(&str, &str)| ((*member).into(), (*variable).into());
        Terminal {
            name: String::new(),
            matching_rule: rule.into(),
            members: members.iter().map(owned).collect(),
        }
    }

    #[test]
    fn what_a_transceiver_sends_the_other_one_receives() {
        let a = terminal(TRANSCEIVER, &[("Tx_Data", "a.tx"), ("Rx_Data", "a.rx")]);
        let b = terminal(TRANSCEIVER, &[("Tx_Data", "b.tx"), ("Rx_Data", "b.rx")]);
        assert_eq!(a.pairs(&b).unwrap(), [("a.tx", "b.rx"), ("a.rx", "b.tx")]);
    }

    #[test]
    fn a_plug_matches_completely_and_a_bus_in_part() {
        let members = [("u", "force"), ("y", "theta")];
        let (full, part) = (&members[..], &members[..1]);
        let message = |a: &Terminal, b: &Terminal| a.pairs(b).unwrap_err().to_string();
        assert_eq!(terminal("plug", full).pairs(&terminal("plug", full)).unwrap().len(), 2);
        assert_eq!(
            message(&terminal("plug", full), &terminal("plug", part)),
            "the other terminal has no y"
        );
        assert_eq!(
            message(&terminal("plug", part), &terminal("plug", full)),
            "the terminals have 1 and 2 members; expected as many"
        );
        let buses = (terminal("bus", full), terminal("bus", part));
        assert_eq!(buses.0.pairs(&buses.1).unwrap(), [("force", "force")]);
        assert_eq!(
            message(&buses.0, &terminal("bus", &[("z", "z")])),
            "the terminals have no members in common"
        );
        assert_eq!(
            message(&buses.0, &terminal("plug", full)),
            "the terminals have different matching rules: bus and plug"
        );
        assert_eq!(
            message(&terminal("none", full), &terminal("none", full)),
            format!("the matching rule none is not supported; expected plug, bus or {TRANSCEIVER}")
        );
    }

    #[test]
    fn terminals_in_terminals_have_the_name_of_both() {
        let text = r#"<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals>
            <Terminal name="can" matchingRule="org.fmi-ls-bus.transceiver">
              <TerminalMemberVariable memberName="Tx_Data" variableName="can.Tx_Data" variableKind="signal"/>
              <Terminal name="Configuration" matchingRule="bus">
                <TerminalMemberVariable memberName="b" variableName="can.b" variableKind="signal"/>
              </Terminal>
            </Terminal></Terminals></fmiTerminalsAndIcons>"#;
        let names =
            Vec::from_iter(read(text).unwrap().into_iter().map(|t| (t.name, t.members.len())));
        assert_eq!(names, [("can.Configuration".to_owned(), 1), ("can".to_owned(), 1)]);
        assert!(read("<fmiTerminalsAndIcons>").unwrap_err().to_string().contains(TERMINALS));
    }
}
