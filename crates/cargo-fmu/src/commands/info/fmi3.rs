//! What FMUs of FMI 3.0 have beyond those of FMI 2.0: arrays, aliases, terminals, more interface types.

use std::collections::HashMap;
use std::io::Write;

use anyhow::Result;
use fmu_build::table::Row;
use fmu_description::model::item;
use fmu_description::value::boolean;
use fmu_description::xml::{self, Element};
use fmu_file::archive::Archive;
use fmu_file::text::plain;

use super::MAX_WIDTH;

/// The icon of an FMU.
pub const ICON: &str = "terminalsAndIcons/icon.png";
const TERMINALS: &str = "terminalsAndIcons/terminalsAndIcons.xml";
/// Maximum number of bytes that are read of the terminals.
const MAX_TERMINALS: u64 = 64 << 20;

/// The interface types, their titles, and what each may be able to do (FMI 3.0.2, sections 2.4.2, 3.4
/// and 4.4).
const INTERFACES: [(&str, &str, &[&str]); 3] = [
    (
        "ModelExchange",
        "model exchange",
        &[
            "needsCompletedIntegratorStep",
            "providesEvaluateDiscreteStates",
        ],
    ),
    (
        "CoSimulation",
        "co-simulation",
        &[
            "canHandleVariableCommunicationStepSize",
            "providesIntermediateUpdate",
            "mightReturnEarlyFromDoStep",
            "canReturnEarlyAfterIntermediateUpdate",
            "hasEventMode",
            "providesEvaluateDiscreteStates",
        ],
    ),
    ("ScheduledExecution", "scheduled execution", &[]),
];
const COMMON: [&str; 7] = [
    "needsExecutionTool",
    "canBeInstantiatedOnlyOncePerProcess",
    "canGetAndSetFMUState",
    "canSerializeFMUState",
    "providesDirectionalDerivatives",
    "providesAdjointDerivatives",
    "providesPerElementDependencies",
];
/// Numbers of co-simulation that are shown if given.
const NUMBERS: [&str; 3] = [
    "fixedInternalStepSize",
    "maxOutputDerivativeOrder",
    "recommendedIntermediateInputSmoothness",
];

/// Whether a model description is of FMI 3.
pub fn is_of(root: &Element<'_>) -> bool {
    let version = root.attribute("fmiVersion").unwrap_or_default();
    root.name == "fmiModelDescription" && version.starts_with("3.")
}

/// Prints what follows the header.
pub fn print(root: &Element<'_>, mut archive: Archive, out: &mut impl Write) -> Result<()> {
    for (name, title, capabilities) in INTERFACES {
        if let Some(interface) = root.child(name) {
            writeln!(out, "\n{title}")?;
            for capability in COMMON.iter().chain(capabilities) {
                let flag = interface.attribute(capability).and_then(boolean);
                writeln!(out, "  {capability:40} {}", flag.unwrap_or(false))?;
            }
            for number in NUMBERS {
                if let Some(value) = interface.attribute(number) {
                    writeln!(out, "  {number:40} {}", plain(value, MAX_WIDTH))?;
                }
            }
        }
    }
    let types: HashMap<&str, &Element<'_>> = (root.child("TypeDefinitions").into_iter())
        .flat_map(|types| &types.children)
        .filter_map(|defined| Some((defined.attribute("name")?, defined)))
        .collect();
    let variables = || (root.child("ModelVariables").into_iter()).flat_map(|list| &list.children);
    let names: HashMap<&str, &str> = variables()
        .filter_map(|v| Some((v.attribute("valueReference")?, v.attribute("name")?)))
        .collect();
    let rows = variables().flat_map(|variable| rows(variable, &types, &names));
    super::variables(rows, 0, out)?;
    let enumerations = root.list("TypeDefinitions", "EnumerationType");
    super::enumerations(
        enumerations.map(|defined| (defined.attribute("name").unwrap_or_default(), defined)),
        out,
    )?;
    let Ok(bytes) = archive.head(TERMINALS, MAX_TERMINALS) else {
        return Ok(());
    };
    let text = xml::decode(&bytes).text;
    let mut lines = Vec::new();
    if let Ok(document) = xml::parse(&text)
        && let Some(list) = document.child("Terminals")
    {
        terminals(list, 1, &mut lines);
    }
    if !lines.is_empty() {
        writeln!(out, "\nterminals")?;
    }
    for line in lines {
        writeln!(out, "{line}")?;
    }
    Ok(())
}

/// The rows of a variable and its aliases.
fn rows(
    variable: &Element<'_>,
    types: &HashMap<&str, &Element<'_>>,
    names: &HashMap<&str, &str>,
) -> Vec<Row> {
    let text = |name: &str| variable.attribute(name).unwrap_or_default().to_owned();
    let declared = variable.attribute("declaredType");
    let declared = declared.and_then(|name| types.get(name));
    let inherited = |name: &str| {
        let own = variable.attribute(name);
        own.or_else(|| declared?.attribute(name)).map(str::to_owned)
    };
    let variability = match variable.name {
        _ if text("causality").to_lowercase().ends_with("parameter") => "fixed",
        "Float32" | "Float64" => "continuous",
        _ => "discrete",
    };
    let sizes: Vec<&str> = (variable.children("Dimension"))
        .map(|dimension| {
            let reference = dimension.attribute("valueReference");
            let name = reference.and_then(|reference| names.get(reference).copied());
            dimension.attribute("start").or(name).unwrap_or("?")
        })
        .collect();
    let kind = match sizes.is_empty() {
        true => variable.name.to_owned(),
        false => format!("{}[{}]", variable.name, sizes.join(", ")),
    };
    let texts = variable
        .children("Start")
        .filter_map(|start| start.attribute("value"));
    let start = match variable.attribute("start") {
        None => texts.collect::<Vec<_>>().join(" "),
        Some(start) => {
            let items = declared
                .into_iter()
                .flat_map(|defined| defined.children("Item"));
            let found = items
                .filter_map(item)
                .find(|(_, value)| start == value.to_string());
            found.map_or(start, |(name, _)| name).to_owned()
        }
    };
    let range = match (inherited("min"), inherited("max")) {
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (Some(min), None) => format!("from {min}"),
        (None, Some(max)) => format!("to {max}"),
        (None, None) => String::new(),
    };
    let row = [
        text("name"),
        variable
            .attribute("causality")
            .unwrap_or("local")
            .to_owned(),
        variable
            .attribute("variability")
            .unwrap_or(variability)
            .to_owned(),
        kind,
        inherited("unit").unwrap_or_default(),
        start,
        range,
        text("description"),
    ];
    let alias = |alias: &Element<'_>| {
        let mut row = row.clone();
        row[0] = alias.attribute("name").unwrap_or_default().to_owned();
        row[5] = String::new();
        row[7] = format!("alias of {}", text("name"));
        row
    };
    let aliases: Vec<Row> = variable.children("Alias").map(alias).collect();
    [row].into_iter().chain(aliases).collect()
}

/// Adds a line for each terminal and those in it.
fn terminals(parent: &Element<'_>, depth: usize, lines: &mut Vec<String>) {
    for terminal in parent.children("Terminal") {
        let text = |name: &str| terminal.attribute(name).unwrap_or_default();
        let members: Vec<&str> = (terminal.children.iter())
            .flat_map(|member| {
                [
                    "variableName",
                    "inStreamVariableName",
                    "outStreamVariableName",
                ]
                .into_iter()
                .filter_map(|name| member.attribute(name))
            })
            .collect();
        let line = format!(
            "{} ({}): {}",
            text("name"),
            text("matchingRule"),
            members.join(", ")
        );
        lines.push(format!("{:1$}{2}", "", 2 * depth, plain(&line, MAX_WIDTH)));
        terminals(terminal, depth + 1, lines);
    }
}
