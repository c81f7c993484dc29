//! A page with the traces of runs, which needs nothing beside it.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use fmu_file::replace::Replacement;
use fmu_master::table;
use serde_json::{Value, json};

const PAGE: &str = include_str!("plot/page.html");

/// Writes a page with the rows of CSV files, over each other; each file has the name of its run.
///
/// # Errors
/// A file is not a table with a column of times, or the page cannot be written.
pub fn write(page: &Path, title: &str, runs: &[(String, &Path)]) -> Result<()> {
    let runs = runs.iter().map(|(name, file)| {
        let cannot = || format!("{} cannot be plotted", file.display());
        let text = fs::read_to_string(file).with_context(cannot)?;
        run(name, &text).with_context(cannot)
    });
    let runs = Value::Array(runs.collect::<Result<_>>()?);
    // No text of a table ends the element that holds it.
    let runs = runs.to_string().replace('<', "\\u003c");
    let escaped = title.replace('&', "&amp;").replace('<', "&lt;");
    let mut text = PAGE.to_owned();
    for (place, content) in [
        ("{{title}}", escaped.as_str()),
        ("{{licence}}", include_str!("plot/LICENSE")),
        ("{{uplot.css}}", include_str!("plot/uPlot.min.css")),
        ("{{uplot.js}}", include_str!("plot/uPlot.iife.min.js")),
        ("{{runs}}", &runs),
    ] {
        text = text.replace(place, content);
    }
    let mut output = Replacement::of(page)?;
    let written = output.write_all(text.as_bytes());
    written.with_context(|| format!("cannot write {}", page.display()))?;
    output.finish()
}

/// The rows of a table by column. Columns without numbers are left out.
fn run(name: &str, text: &str) -> Result<Value> {
    let (titles, mut rest) = table::fields(text).context("line 1, expected names in CSV")?;
    let mut columns = vec![Vec::new(); titles.len()];
    let mut line = 1;
    while !rest.is_empty() {
        line += 1;
        let fields;
        (fields, rest) =
            table::fields(rest).with_context(|| format!("line {line}, expected fields of CSV"))?;
        let (found, expected) = (fields.len(), columns.len());
        ensure!(found == expected, "line {line} has {found} fields, expected {expected}");
        for (column, field) in columns.iter_mut().zip(&fields) {
            column.push(number(field.as_deref()));
        }
    }
    let mut named = titles.iter().map(|title| {
        let title = title.as_deref().unwrap_or_default();
        let parts = title.strip_suffix(']').and_then(|title| title.rsplit_once(" ["));
        parts.unwrap_or((title, ""))
    });
    let mut columns = columns.into_iter();
    let (Some(("time", _)), Some(time)) = (named.next(), columns.next()) else {
        bail!("line 1 has no column time, expected it first");
    };
    let columns = named.zip(columns).filter(|(_, values)| values.iter().any(|v| !v.is_null()));
    let columns = columns.map(|((name, unit), mut values)| {
        if values.windows(2).all(|pair| pair[0] == pair[1]) {
            values.truncate(1);
        }
        json!({"name": name, "unit": unit, "values": values})
    });
    Ok(json!({"name": name, "time": time, "columns": Vec::from_iter(columns)}))
}

/// A field as a number, null if it is none. Values have the digits of `f32`, more than a screen shows.
fn number(field: Option<&str>) -> Value {
    match field {
        Some("true") => json!(1),
        Some("false") => json!(0),
        field => {
            let number: Option<f64> = field.and_then(|field| field.parse().ok());
            let short = number.and_then(|number| (number as f32).to_string().parse::<f64>().ok());
            json!(short.filter(|number| number.is_finite()))
        }
    }
}

/// Shows a page in the browser, which goes on without this process.
///
/// # Errors
/// The system has no program that opens pages.
pub fn open(page: &Path) -> Result<()> {
    let program = match std::env::consts::OS {
        "macos" => "open",
        "windows" => "explorer",
        _ => "xdg-open",
    };
    Command::new(program)
        .arg(page)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .with_context(|| format!("{} cannot be opened with {program}", page.display()))?;
    Ok(())
}
