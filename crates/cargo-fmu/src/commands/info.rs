//! `cargo fmu info`: what is in an FMU.

use std::io::Write;
use std::path::Path;

use anyhow::{Error, Result};
use fmu_build::table;
use fmu_description::{Capability, ModelDescription, xml};
use fmu_file::archive::{Archive, DOCUMENTATION, ICON, MODEL_DESCRIPTION};
use fmu_file::platform;
use fmu_file::text::{about, plain};

/// No cell is wider than this.
const MAX_WIDTH: usize = 200;

/// Writes what is in an FMU.
///
/// # Errors
/// The file is not a sound FMU, or `out` cannot be written.
pub fn print(file: &Path, out: &mut impl Write) -> Result<()> {
    let (archive, text) = open(file).map_err(|error| about(file, &error))?;
    let cannot = |error: Error| {
        about(
            file,
            &error.context(format!("{MODEL_DESCRIPTION} cannot be read")),
        )
    };
    let root = xml::parse(&text).map_err(cannot)?;
    let model = ModelDescription::read(&root).map_err(cannot)?;
    header(&model, &archive, out)?;
    capabilities(&model, out)?;
    variables(&model, out)?;
    Ok(())
}

fn open(file: &Path) -> Result<(Archive, String)> {
    let mut archive = Archive::open_sound(file)?;
    let text = archive.model_description()?;
    Ok((archive, text))
}

fn header(model: &ModelDescription<'_>, archive: &Archive, out: &mut impl Write) -> Result<()> {
    let times = [
        ("start", "startTime"),
        ("stop", "stopTime"),
        ("step", "stepSize"),
    ];
    let experiment: Vec<String> = times
        .iter()
        .filter_map(|(name, attribute)| Some(format!("{name} {} s", model.experiment(attribute)?)))
        .collect();
    let platforms: Vec<&str> = platform::folders(&archive.names).into_iter().collect();
    let documents: Vec<&str> = [DOCUMENTATION, ICON]
        .into_iter()
        .filter(|file| archive.names.iter().any(|name| name == file))
        .collect();
    let text = |name| model.root.attribute(name).unwrap_or_default().to_owned();
    let lines = [
        ("model", text("modelName")),
        ("description", text("description")),
        ("FMI version", text("fmiVersion")),
        ("GUID", text("guid")),
        ("version", text("version")),
        ("licence", text("license")),
        ("made by", text("generationTool")),
        ("experiment", experiment.join(", ")),
        ("platforms", platforms.join(" ")),
        ("documents", documents.join(" ")),
        ("size", format!("{} KB", archive.size.div_ceil(1000))),
    ];
    for (name, value) in lines {
        if !value.is_empty() {
            writeln!(out, "{name:12} {}", plain(&value, MAX_WIDTH))?;
        }
    }
    Ok(())
}

fn capabilities(model: &ModelDescription<'_>, out: &mut impl Write) -> Result<()> {
    let Some(slave) = model.co_simulation() else {
        writeln!(out, "\nnot for co-simulation")?;
        return Ok(());
    };
    writeln!(out, "\nco-simulation")?;
    for capability in Capability::ALL {
        let (name, flag) = (capability.as_str(), capability.is_claimed_by(slave));
        writeln!(out, "  {name:40} {flag}")?;
    }
    let order = slave.attribute("maxOutputDerivativeOrder").unwrap_or("0");
    writeln!(
        out,
        "  {:40} {}",
        "maxOutputDerivativeOrder",
        plain(order, MAX_WIDTH)
    )?;
    Ok(())
}

fn variables(model: &ModelDescription<'_>, out: &mut impl Write) -> Result<()> {
    let cells = |row: table::Row| row.map(|cell| plain(&cell, MAX_WIDTH));
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
    // On a terminal a long description is cut off rather than wrapped into the columns.
    let terminal = terminal_size::terminal_size_of(std::io::stdout());
    let width = terminal.map_or(usize::MAX, |(width, _)| usize::from(width.0));
    writeln!(out, "\n{} variables", rows.len() - 1)?;
    for row in &rows {
        let line: String = row
            .iter()
            .zip(widths)
            .map(|(cell, width)| format!("  {cell:width$}"))
            .collect();
        let line: String = line.trim_end().chars().take(width).collect();
        writeln!(out, "{line}")?;
    }
    Ok(())
}
