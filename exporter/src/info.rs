//! `cargo fmu info`: what is in an FMU.

use std::collections::{BTreeSet, HashMap};
use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::text::plain;
use fmu_file::xml;
use model_description::schema::{ModelDescription, ScalarVariable, TypeDefinitions};

/// No cell is wider than this.
const WIDEST: usize = 200;
/// No reason is longer than this.
const LONGEST: usize = 1000;

/// Writes what is in an FMU.
///
/// # Errors
/// The file is not a sound FMU, or `out` cannot be written.
pub fn print(file: &Path, out: &mut impl Write) -> Result<()> {
    // The reason may quote the file.
    let (archive, model) = read(file).map_err(|error| {
        let reason = plain(&format!("{error:#}"), LONGEST);
        anyhow!("{}: {reason}", file.display())
    })?;
    header(&model, &archive, out)?;
    capabilities(&model, out)?;
    variables(&model, out)?;
    Ok(())
}

fn read(file: &Path) -> Result<(Archive, ModelDescription)> {
    let mut archive = Archive::open_sound(file)?;
    let text = archive.model_description()?;
    let cannot = || format!("{MODEL_DESCRIPTION} cannot be read");
    // This reader has bounds, and the one that knows the types has none.
    xml::parse(&text).with_context(cannot)?;
    let model = ModelDescription::from_xml(&text).with_context(cannot)?;
    Ok((archive, model))
}

fn header(model: &ModelDescription, archive: &Archive, out: &mut impl Write) -> Result<()> {
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
    let platforms: BTreeSet<&str> = archive
        .names
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
        ("size", Some(format!("{} KB", archive.size.div_ceil(1000)))),
    ];
    for (name, value) in lines {
        if let Some(value) = value {
            writeln!(out, "{name:12} {}", plain(&value, WIDEST))?;
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
    let items = items(model.type_definitions.as_ref());
    rows.extend(variables.iter().map(|v| row(v, &items)));
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

/// Names of the items of enumerations, by the names of the types and the values of the items.
type Items<'a> = HashMap<(&'a str, i32), &'a str>;

fn items(types: Option<&TypeDefinitions>) -> Items<'_> {
    let types = types.into_iter().flat_map(|types| &types.types);
    let items = types.flat_map(|defined| {
        let items = defined.enumeration.iter().flat_map(|e| &e.items);
        items.map(|item| ((defined.name.as_str(), item.value), item.name.as_str()))
    });
    items.collect()
}

fn row(v: &ScalarVariable, items: &Items<'_>) -> [String; 8] {
    let (kind, value) = v
        .value()
        .map_or(("", None), |(kind, value)| (kind, Some(value)));
    let text = |text: Option<&String>| text.cloned().unwrap_or_default();
    let declared = value.and_then(|value| value.declared_type.as_deref());
    let item = |value: &str| items.get(&(declared?, value.parse().ok()?)).copied();
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
        item(&start).map_or(start.clone(), str::to_owned),
        range,
        text(v.description.as_ref()),
    ]
    .map(|cell| plain(&cell, WIDEST))
}
