//! Terminals, by which tools connect several variables at once, and the icon (FMI 3.0.2, section 2.4.9).

use anyhow::{Result, ensure};

use super::{Description, FmiVersion};
use crate::xml::Element;

/// Corners of the icon and of the coordinate system that it fills.
const CORNERS: [(&str, i32); 4] = [("x1", -100), ("y1", -100), ("x2", 100), ("y2", 100)];

impl Description {
    /// Generates `terminalsAndIcons.xml` of FMI 3.0; `None` if there is neither a terminal nor an icon.
    /// Two terminals match if they have members of the same names.
    ///
    /// # Errors
    /// Two members of a terminal have the same name.
    pub fn terminals(&self, has_icon: bool) -> Result<Option<Element<'static>>> {
        let mut terminals: Vec<Element<'static>> = Vec::new();
        for variable in &self.variables {
            let Some((name, member)) = variable.terminal.split_once('.') else {
                continue;
            };
            let index = match terminals
                .iter()
                .position(|t| t.attribute("name") == Some(name))
            {
                Some(index) => index,
                None => {
                    let terminal = Element::new("Terminal").with("name", name);
                    terminals.push(terminal.with("matchingRule", "plug"));
                    terminals.len() - 1
                }
            };
            let members = &mut terminals[index].children;
            ensure!(
                members
                    .iter()
                    .all(|other| other.attribute("memberName") != Some(member)),
                "two variables of {} are the member {member} of the terminal {name}; expected different members",
                self.name
            );
            members.push(
                Element::new("TerminalMemberVariable")
                    .with("variableName", &variable.name)
                    .with("memberName", member)
                    .with("variableKind", "signal"),
            );
        }
        let is_empty = terminals.is_empty() && !has_icon;
        let root = Element::new("fmiTerminalsAndIcons")
            .with("fmiVersion", FmiVersion::Fmi3.as_str())
            .holding_all(has_icon.then(graphics))
            .listing("Terminals", terminals);
        Ok((!is_empty).then_some(root))
    }
}

fn graphics() -> Element<'static> {
    let corners = |name| {
        let element = Element::new(name);
        CORNERS
            .iter()
            .fold(element, |element, (name, value)| element.with(name, value))
    };
    Element::new("GraphicalRepresentation")
        .holding(corners("CoordinateSystem").with("suggestedScalingFactorTo_mm", 0.1))
        .holding(corners("Icon"))
}
