//! `cargo fmu info`: what is in an FMU.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result};
use model_description::schema::{ModelDescription, ScalarVariable, TypeDefinitions};

use crate::archive::{self, Contents};

/// Writes what is in an FMU.
///
/// # Errors
/// The file is not a sound FMU, or `out` cannot be written.
pub fn print(file: &Path, out: &mut impl Write) -> Result<()> {
    let contents = archive::read(file)?;
    let model = ModelDescription::from_xml(&contents.xml)
        .with_context(|| format!("{}: modelDescription.xml cannot be read", file.display()))?;
    header(&model, &contents, out)?;
    capabilities(&model, out)?;
    variables(&model, out)?;
    Ok(())
}

fn header(model: &ModelDescription, contents: &Contents, out: &mut impl Write) -> Result<()> {
    let experiment = model.default_experiment.as_ref().map(|e| {
        [
            ("start", e.start_time),
            ("stop", e.stop_time),
            ("step", e.step_size),
        ]
        .iter()
        .filter_map(|(name, value)| value.map(|value| format!("{name} {value} s")))
        .collect::<Vec<_>>()
        .join(", ")
    });
    let platforms: BTreeSet<&str> = contents
        .files
        .iter()
        .filter_map(|file| file.strip_prefix("binaries/")?.split('/').next())
        .collect();
    let platforms: Vec<&str> = platforms.into_iter().collect();
    let lines = [
        ("model", Some(model.model_name.clone())),
        ("description", model.description.clone()),
        ("FMI version", Some(model.fmi_version.clone())),
        ("GUID", Some(model.guid.clone())),
        ("version", model.version.clone()),
        ("licence", model.license.clone()),
        ("made by", model.generation_tool.clone()),
        ("experiment", experiment),
        ("platforms", Some(platforms.join(" "))),
        ("size", Some(format!("{} KB", contents.size.div_ceil(1000)))),
    ];
    for (name, value) in lines {
        if let Some(value) = value {
            writeln!(out, "{name:12} {value}")?;
        }
    }
    Ok(())
}

fn capabilities(model: &ModelDescription, out: &mut impl Write) -> Result<()> {
    let Some(slave) = &model.co_simulation else {
        writeln!(out, "\nnot for co-simulation")?;
        return Ok(());
    };
    writeln!(out, "\nco-simulation")?;
    for (name, flag) in slave.capabilities() {
        writeln!(out, "  {name:40} {flag}")?;
    }
    let order = slave.max_output_derivative_order;
    writeln!(out, "  {:40} {order}", "maxOutputDerivativeOrder")?;
    Ok(())
}

fn variables(model: &ModelDescription, out: &mut impl Write) -> Result<()> {
    const HEAD: [&str; 8] = [
        "variable",
        "causality",
        "variability",
        "type",
        "unit",
        "start",
        "range",
        "description",
    ];
    let mut rows = vec![HEAD.map(str::to_owned)];
    let variables = &model.model_variables.variables;
    rows.extend(
        variables
            .iter()
            .map(|v| row(v, model.type_definitions.as_ref())),
    );
    let mut widths = [0; HEAD.len()];
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    writeln!(out, "\n{} variables", variables.len())?;
    for row in &rows {
        let line: String = row
            .iter()
            .zip(widths)
            .map(|(cell, width)| format!("  {cell:width$}"))
            .collect();
        writeln!(out, "{}", line.trim_end())?;
    }
    Ok(())
}

fn row(v: &ScalarVariable, types: Option<&TypeDefinitions>) -> [String; 8] {
    let (kind, value) = v
        .value()
        .map_or(("", None), |(kind, value)| (kind, Some(value)));
    let text = |text: Option<&String>| text.cloned().unwrap_or_default();
    let declared = value.and_then(|value| value.declared_type.as_ref());
    let items = |index: &str| -> Option<String> {
        let types = types?;
        let named = types.types.iter().find(|t| Some(&t.name) == declared)?;
        let items = &named.enumeration.as_ref()?.items;
        let item = items.iter().find(|i| i.value.to_string() == index)?;
        Some(item.name.clone())
    };
    let start = text(value.and_then(|value| value.start.as_ref()));
    let range = match value.map(|value| (&value.min, &value.max)) {
        Some((Some(min), Some(max))) => format!("{min} to {max}"),
        Some((Some(min), None)) => format!("from {min}"),
        Some((None, Some(max))) => format!("to {max}"),
        _ => String::new(),
    };
    [
        v.name.clone(),
        text(v.causality.as_ref()),
        text(v.variability.as_ref()),
        kind.to_owned(),
        text(value.and_then(|value| value.unit.as_ref())),
        items(&start).unwrap_or(start),
        range,
        text(v.description.as_ref()),
    ]
}
