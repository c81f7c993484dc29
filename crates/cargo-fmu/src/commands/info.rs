//! `cargo fmu info`: what is in an FMU.

use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result};
use fmu_build::table;
use fmu_description::schema::ModelDescription;
use fmu_file::archive::{Archive, DOCUMENTATION, ICON, MODEL_DESCRIPTION};
use fmu_file::platform;
use fmu_file::text::{about, plain};
use fmu_file::xml;

/// No cell is wider than this.
const WIDEST: usize = 200;

/// Writes what is in an FMU.
///
/// # Errors
/// The file is not a sound FMU, or `out` cannot be written.
pub fn print(file: &Path, out: &mut impl Write) -> Result<()> {
    let (archive, model) = read(file).map_err(|error| about(file, &error))?;
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
    let platforms: Vec<&str> = platform::folders(&archive.names).into_iter().collect();
    let documents: Vec<&str> = [DOCUMENTATION, ICON]
        .into_iter()
        .filter(|file| archive.names.iter().any(|name| name == file))
        .collect();
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
        (
            "documents",
            (!documents.is_empty()).then(|| documents.join(" ")),
        ),
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
    let cells = |row: table::Row| row.map(|cell| plain(&cell, WIDEST));
    let head = table::HEAD.map(str::to_owned);
    let rows: Vec<_> = [head]
        .into_iter()
        .chain(table::rows(model).map(cells))
        .collect();
    let mut widths = [0; table::HEAD.len()];
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = (*width).max(cell.chars().count());
        }
    }
    writeln!(out, "\n{} variables", rows.len() - 1)?;
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
