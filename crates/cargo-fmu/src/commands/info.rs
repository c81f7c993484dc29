//! `cargo fmu info`: the contents of an FMU.

pub mod json;
mod references;
mod signals;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Error, Result};
use clap::Args;
use fmu_build::table::{self, VariableCells};
use fmu_description::xml::{self, Element};
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::{Archive, DOCUMENTATION, ICON, ICON_3, MODEL_DESCRIPTION, TERMINALS};
use fmu_file::platform;
use fmu_file::text::{about, plain};

use super::files;
use crate::ui::{self, lines};

/// Maximum width of a cell.
const MAX_WIDTH: usize = 200;
/// Maximum length of a description.
const MAX_DESCRIPTION: usize = 2000;
/// The column of descriptions.
const DESCRIPTION: usize = table::HEAD.len() - 1;
/// The least width of descriptions in a table.
const LEAST: usize = 30;
/// Maximum length of the items of an enumeration.
const MAX_ITEMS: usize = 2000;
/// Maximum number of bytes that are read of the terminals.
const MAX_TERMINALS: u64 = 64 << 20;

/// The attributes of an interface type: its element, its title, its flags, and its numbers.
type InterfaceAttributes = [&'static str; 4];

/// The interface types of FMI 2.0.5 (sections 3.3.1 and 4.3.1); both have the flags in `COMMON_2`.
const INTERFACES_2: [InterfaceAttributes; 2] = [
    ["ModelExchange", "model exchange", "completedIntegratorStepNotNeeded", ""],
    [
        "CoSimulation",
        "co-simulation",
        "canHandleVariableCommunicationStepSize canInterpolateInputs canRunAsynchronuously",
        "maxOutputDerivativeOrder",
    ],
];
const COMMON_2: &str = "needsExecutionTool canBeInstantiatedOnlyOncePerProcess \
     canNotUseMemoryManagementFunctions canGetAndSetFMUstate canSerializeFMUstate \
     providesDirectionalDerivative";

/// The interface types of FMI 3.0 (sections 2.4.2, 3.4 and 4.4); all have the flags in `COMMON_3`.
const INTERFACES_3: [InterfaceAttributes; 3] = [
    [
        "ModelExchange",
        "model exchange",
        "needsCompletedIntegratorStep providesEvaluateDiscreteStates",
        "",
    ],
    [
        "CoSimulation",
        "co-simulation",
        "canHandleVariableCommunicationStepSize providesIntermediateUpdate \
         mightReturnEarlyFromDoStep canReturnEarlyAfterIntermediateUpdate hasEventMode \
         providesEvaluateDiscreteStates",
        "fixedInternalStepSize maxOutputDerivativeOrder recommendedIntermediateInputSmoothness",
    ],
    ["ScheduledExecution", "scheduled execution", "", ""],
];
const COMMON_3: &str = "needsExecutionTool canBeInstantiatedOnlyOncePerProcess \
     canGetAndSetFMUState canSerializeFMUState providesDirectionalDerivatives \
     providesAdjointDerivatives providesPerElementDependencies";

/// The attributes of the members of terminals that name variables.
const MEMBERS: [&str; 3] = ["variableName", "inStreamVariableName", "outStreamVariableName"];

/// The FMUs to show.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// The FMUs, from any vendor
    #[arg(required = true)]
    pub files: Vec<PathBuf>,
    /// Print a JSON object, of several FMUs an array. Numbers that JSON does not have are the strings "inf", "-inf" and
    /// "NaN"
    #[arg(long)]
    pub json: bool,
}

/// Prints the contents of FMUs.
///
/// # Errors
/// No file matches a pattern, a file is not a valid FMU, or `out` cannot be written.
pub fn run(args: &InfoArgs, out: &mut impl Write) -> Result<()> {
    let files = files::expanded(&args.files)?;
    if args.json {
        return json::print(&files, out);
    }
    for (index, file) in files.iter().enumerate() {
        if files.len() > 1 {
            let gap = if index > 0 { "\n" } else { "" };
            writeln!(out, "{gap}{}:", file.display())?;
        }
        inspect(file, |model, archive| print(model, archive, out))?;
    }
    Ok(())
}

/// Opens an FMU and reads its model description.
pub(super) fn inspect<R>(
    file: &Path,
    read: impl FnOnce(&ModelDescription<'_>, &mut Archive) -> Result<R>,
) -> Result<R> {
    let (mut archive, text) = open(file).map_err(|error| about(file, &error))?;
    let cannot = |error: Error| {
        let error = error.context(format!("{MODEL_DESCRIPTION} cannot be read"));
        about(file, &error)
    };
    let root = xml::parse(&text).map_err(cannot)?;
    let model = ModelDescription::read(&root).map_err(cannot)?;
    read(&model, &mut archive)
}

/// The flags of all interface types of a version, and the interface types.
fn interface_attributes(version: FmiVersion) -> (&'static str, &'static [InterfaceAttributes]) {
    match version {
        FmiVersion::Fmi2 => (COMMON_2, &INTERFACES_2),
        FmiVersion::Fmi3 => (COMMON_3, &INTERFACES_3),
    }
}

fn print(model: &ModelDescription<'_>, archive: &mut Archive, out: &mut impl Write) -> Result<()> {
    header(model, archive, out)?;
    let (common, attributes) = interface_attributes(model.version);
    interfaces(model, common, attributes, out)?;
    variables(model, out)?;
    enumerations(model, out)?;
    section("clocks", &signals::clock_lines(model), out)?;
    section("binaries", &signals::binary_lines(model), out)?;
    let document = archive.head(TERMINALS, MAX_TERMINALS);
    let text = document.map(|bytes| xml::decode(&bytes).text).unwrap_or_default();
    let mut lines = Vec::new();
    if let Ok(document) = xml::parse(&text)
        && let Some(list) = document.child("Terminals")
    {
        terminals(list, 1, &mut lines);
    }
    section("terminals", &lines, out)?;
    references::print(archive, out)
}

fn open(file: &Path) -> Result<(Archive, String)> {
    let mut archive = Archive::open_sound(file)?;
    let text = archive.model_description()?;
    Ok((archive, text))
}

/// Prints lines below a title, unless there are none.
fn section(title: &str, lines: &[String], out: &mut impl Write) -> Result<()> {
    if !lines.is_empty() {
        writeln!(out, "\n{title}")?;
    }
    for line in lines {
        writeln!(out, "{line}")?;
    }
    Ok(())
}

/// The platforms, the documents, the resources and the sources.
fn contents(archive: &Archive) -> [Vec<&str>; 4] {
    let documents = [DOCUMENTATION, ICON, ICON_3];
    let documents = documents.into_iter().filter(|file| archive.names.iter().any(|n| n == file));
    let below = |folder| {
        let files = archive.names.iter().filter_map(move |name| name.strip_prefix(folder));
        files.filter(|name| !name.is_empty()).collect()
    };
    [
        platform::folders(&archive.names).into_iter().collect(),
        documents.collect(),
        below("resources/"),
        below("sources/"),
    ]
}

fn header(model: &ModelDescription<'_>, archive: &Archive, out: &mut impl Write) -> Result<()> {
    let times = [("start", "startTime"), ("stop", "stopTime"), ("step", "stepSize")];
    let tolerance = model.experiment("tolerance");
    let experiment: Vec<String> = times
        .iter()
        .filter_map(|(name, attribute)| Some(format!("{name} {} s", model.experiment(attribute)?)))
        .chain(tolerance.map(|value| format!("tolerance {value:?}")))
        .collect();
    let [platforms, documents, resources, sources] = contents(archive);
    let text = |name| model.root.attribute(name).unwrap_or_default().to_owned();
    let lines = [
        ("model", text("modelName")),
        ("description", text("description")),
        ("FMI version", text("fmiVersion")),
        ("GUID", text("guid")),
        ("token", text("instantiationToken")),
        ("version", text("version")),
        ("author", text("author")),
        ("copyright", text("copyright")),
        ("licence", text("license")),
        ("generated by", text("generationTool")),
        ("experiment", experiment.join(", ")),
        ("platforms", platforms.join(" ")),
        ("documents", documents.join(" ")),
        ("resources", resources.join(" ")),
        ("sources", sources.join(" ")),
        ("size", format!("{} KB", archive.size.div_ceil(1000))),
    ];
    for (name, value) in lines.iter().filter(|(_, value)| !value.is_empty()) {
        let line = format!("{name:12} {}", plain(value, MAX_WIDTH));
        writeln!(out, "{}", ui::filled(&line, ui::width(), &" ".repeat(13)))?;
    }
    Ok(())
}

/// Prints what the interface types that the FMU has can do. Numbers are shown if they are given, in FMI 2.0 also
/// if not.
fn interfaces(
    model: &ModelDescription<'_>,
    common: &str,
    interfaces: &[InterfaceAttributes],
    out: &mut impl Write,
) -> Result<()> {
    for [name, title, flags, numbers] in interfaces {
        let Some(interface) = model.root.child(name) else { continue };
        let default = (model.version == FmiVersion::Fmi2).then_some("0");
        let flags = common.split_whitespace().chain(flags.split_whitespace());
        let flags = flags.map(|name| format!("  {name:40} {}", interface.is_true(name)));
        let numbers = numbers.split_whitespace().filter_map(|name| {
            let value = plain(interface.attribute(name).or(default)?, MAX_WIDTH);
            Some(format!("  {name:40} {value}"))
        });
        section(title, &flags.chain(numbers).collect::<Vec<_>>(), out)?;
    }
    Ok(())
}

/// Prints a table of the variables, without those that are invalid.
fn variables(model: &ModelDescription<'_>, out: &mut impl Write) -> Result<()> {
    let cells = |row: VariableCells| row.map(|cell| plain(&cell, MAX_DESCRIPTION));
    let rows = Vec::from_iter(table::rows(model).map(cells));
    let number = ui::count(rows.len(), "variable");
    let lines = match ui::width() {
        Some(width) => variables_in(rows, width),
        None => table_of(rows),
    };
    let left_out = match model.variables.iter().filter(|v| v.is_none()).count() {
        0 => String::new(),
        invalid => format!(", without {invalid} invalid"),
    };
    section(&format!("{number}{left_out}"), &lines, out)
}

/// The lines of a table of variables.
fn table_of(rows: Vec<VariableCells>) -> Vec<String> {
    let rows = Vec::from_iter([table::HEAD.map(str::to_owned)].into_iter().chain(rows));
    lines(&rows, true).map(|line| format!("  {line}")).collect()
}

/// Variables on a terminal with a width: as a table, whose descriptions may take several lines, or below each other.
fn variables_in(rows: Vec<VariableCells>, width: usize) -> Vec<String> {
    let mut short = rows.clone();
    short.iter_mut().for_each(|row| row[DESCRIPTION].clear());
    let columns = table_of(short).iter().map(|line| line.chars().count()).max().unwrap_or(0);
    let place = columns - table::HEAD[DESCRIPTION].len();
    if place + LEAST <= width {
        let indent = " ".repeat(place);
        let lines = table_of(rows);
        return lines.iter().flat_map(|line| filled(line, width, &indent)).collect();
    }
    let name = |row: &VariableCells| row[0].chars().count();
    let widest = rows.iter().map(name).max().unwrap_or(0).min(width / 3);
    let indent = " ".repeat(2 + widest + 2);
    let stacked = rows.iter().flat_map(|row| {
        let [variable, causality, variability, kind, unit, start, range, description] = row;
        let named = [("", unit), ("start ", start), ("", range)];
        let named = named.iter().filter(|(_, cell)| !cell.is_empty());
        let named = named.map(|(name, cell)| format!("{name}{cell}"));
        let words = [format!("{variability} {causality}"), kind.clone()].into_iter().chain(named);
        let mut lines = vec![format!("  {variable}")];
        let about = [Vec::from_iter(words).join(", "), description.clone()];
        for text in about.iter().filter(|text| !text.is_empty()) {
            lines.extend(filled(&format!("{indent}{text}"), width, &indent));
        }
        // The first line of the properties is beside the name, if that is short.
        if variable.chars().count() <= widest {
            let first = lines.remove(1);
            lines[0] = format!("  {variable:widest$}  {}", first.trim_start());
        }
        lines
    });
    stacked.collect()
}

/// The lines of a text on a terminal.
fn filled(text: &str, width: usize, indent: &str) -> Vec<String> {
    ui::filled(text, Some(width), indent).lines().map(str::to_owned).collect()
}

fn enumerations(model: &ModelDescription<'_>, out: &mut impl Write) -> Result<()> {
    let lines = model.enumerations().map(|of_type| {
        let items = of_type.items.iter();
        let items: Vec<_> = items.map(|item| format!("{} = {}", item.name, item.value)).collect();
        let line = format!("{}: {}", of_type.name, items.join(", "));
        ui::filled(&format!("  {}", plain(&line, MAX_ITEMS)), ui::width(), "    ")
    });
    section("enumerations", &lines.collect::<Vec<_>>(), out)
}

/// Adds a line for each terminal and those in it.
fn terminals(parent: &Element<'_>, depth: usize, lines: &mut Vec<String>) {
    for terminal in parent.children("Terminal") {
        let text = |name: &str| terminal.attribute(name).unwrap_or_default();
        let members: Vec<&str> = (terminal.children.iter())
            .flat_map(|member| MEMBERS.into_iter().filter_map(|name| member.attribute(name)))
            .collect();
        let about = [text("matchingRule"), text("terminalKind")];
        let about = Vec::from_iter(about.into_iter().filter(|text| !text.is_empty())).join(", ");
        let line = format!("{} ({about}): {}", text("name"), members.join(", "));
        lines.push(format!("{:1$}{2}", "", 2 * depth, plain(&line, MAX_WIDTH)));
        terminals(terminal, depth + 1, lines);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(name: &str, start: &str, description: &str) -> VariableCells {
        [name, "parameter", "tunable", "Real", "N", start, "0 to 9", description].map(str::to_owned)
    }

    #[test]
    fn a_terminal_shows_all_words_of_descriptions_below_the_properties_or_beside_them() {
        let description = "a gain that is described at length, so that it takes several lines";
        let rows = vec![row("k", "1", description), row(&"long_name".repeat(9), "2", "short")];
        for width in [80, 200, 240] {
            let lines = variables_in(rows.clone(), width);
            let is_narrow = |line: &&String| line.chars().count() <= width;
            assert!(
                lines.iter().filter(|line| !line.contains("long")).all(|line| is_narrow(&line))
            );
            let text = lines.join(" ");
            let words = Vec::from_iter(text.split_whitespace());
            for word in description.split(' ').chain(["short"]) {
                assert!(words.contains(&word), "{word}: {lines:#?}");
            }
        }
        let lines = variables_in(rows[..1].to_vec(), 60);
        let expected = [
            "  k  tunable parameter, Real, N, start 1, 0 to 9",
            "     a gain that is described at length, so that it takes",
            "     several lines",
        ];
        assert_eq!(lines, expected);
    }
}
