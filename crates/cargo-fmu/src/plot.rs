//! Pages with the traces of runs or the metrics of a sweep, which need nothing beside them.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use fmu_description::Value as Cell;
use fmu_file::replace::{self, Replacement};
use fmu_master::table::{self, Series};
use serde_json::{Value, json};

use crate::commands::info::json;
use crate::filled;

const RUNS: &str = include_str!("plot/page.html");
const SWEEP: &str = include_str!("plot/sweep.html");

/// More runs of a sweep make a page slow.
const MOST_RUNS: usize = 20_000;

/// The page to draw.
#[derive(Debug, Args)]
pub struct Page {
    /// Draw the results on a page for the browser
    #[arg(long = "plot", value_name = "FILE.html", value_parser = page)]
    pub file: Option<PathBuf>,
    /// Open the page in the browser
    #[arg(long, requires = "file")]
    pub open: bool,
}

/// The file of a page.
fn page(file: &str) -> Result<PathBuf, &'static str> {
    let file = PathBuf::from(file);
    let extension = file.extension().unwrap_or_default();
    let is_page = ["html", "htm"].iter().any(|known| extension.eq_ignore_ascii_case(known));
    is_page.then_some(file).ok_or("expected the name of an HTML page, such as loop.html")
}

impl Page {
    /// Checks before the results are computed that the page can be written.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn check(&self) -> Result<()> {
        let Some(page) = &self.file else { return Ok(()) };
        let folder = page.parent().filter(|folder| *folder != Path::new("") && !folder.is_dir());
        if let Some(folder) = folder {
            bail!("there is no folder {} for the page", folder.display());
        }
        ensure!(!page.is_dir(), "{} is a folder, expected a page", page.display());
        Replacement::new(page).map(drop)
    }

    /// Draws files with the rows of runs over each other; each file has the name of its run.
    ///
    /// # Errors
    /// A file is not a table with a column of times, or the page cannot be written or shown.
    pub fn draw_runs(
        &self,
        title: &str,
        runs: &[(String, &Path)],
        out: &mut impl Write,
    ) -> Result<()> {
        let Some(page) = &self.file else { return Ok(()) };
        let runs = runs.iter().map(|(name, file)| {
            let run = table::read(file).and_then(|table| run(name, &table));
            run.with_context(|| format!("{} cannot be plotted", file.display()))
        });
        self.finish(page, RUNS, title, &Value::Array(runs.collect::<Result<_>>()?), out)
    }

    /// Draws the table of a sweep.
    ///
    /// # Errors
    /// The file cannot be read, or the page cannot be written or shown.
    pub fn draw_sweep(&self, title: &str, file: &Path, out: &mut impl Write) -> Result<()> {
        let Some(page) = &self.file else { return Ok(()) };
        let table = table::read(file);
        let table = table.with_context(|| format!("{} cannot be plotted", file.display()))?;
        self.finish(page, SWEEP, title, &sweep(&table), out)
    }

    /// Writes and shows a page with its data.
    fn finish(
        &self,
        page: &Path,
        template: &str,
        title: &str,
        runs: &Value,
        out: &mut impl Write,
    ) -> Result<()> {
        // No text of a table ends the element that holds it.
        let runs = runs.to_string().replace('<', "\\u003c");
        let escaped = title.replace('&', "&amp;").replace('<', "&lt;");
        let values = [
            ("{{title}}", escaped.as_str()),
            ("{{page.css}}", include_str!("plot/page.css")),
            ("{{licence}}", include_str!("plot/LICENSE")),
            ("{{uplot.css}}", include_str!("plot/uPlot.min.css")),
            ("{{uplot.js}}", include_str!("plot/uPlot.iife.min.js")),
            ("{{runs}}", &runs),
        ];
        replace::write(page, filled(template, &values).as_bytes())?;
        writeln!(out, "wrote {}", page.display())?;
        if self.open { open(page) } else { Ok(()) }
    }
}

/// The rows of a run by column; of a column with a text, all values are texts. Columns without values are left out.
fn run(name: &str, table: &[Series]) -> Result<Value> {
    // With all digits: far from zero, the digits of `f32` do not tell the times of small steps apart.
    let time = table::times(table)?;
    let columns = table.iter().skip(1).filter_map(|series| {
        let is_text = series.cells.iter().flatten().any(|cell| matches!(cell, Cell::String(_)));
        let values = series.cells.iter().enumerate().map(|(row, cell)| match is_text {
            true => cell.as_ref().map(Cell::to_string).into(),
            false => series.number(row).map_or(Value::Null, number),
        });
        let mut values = Vec::from_iter(values);
        if values.iter().all(Value::is_null) {
            return None;
        }
        if values.windows(2).all(|pair| pair[0] == pair[1]) {
            values.truncate(1);
        }
        Some(json!({"name": series.name, "unit": series.unit, "values": values}))
    });
    let columns = Vec::from_iter(columns);
    Ok(json!({"name": name, "time": time, "columns": columns}))
}

/// The rows of a sweep by column, of many runs those in equal distances and the best one.
fn sweep(table: &[Series]) -> Value {
    let named = |name: &str| table.iter().position(|series| series.name == name);
    let runs = table.first().map_or(0, |series| series.cells.len());
    let iae = |run| {
        let diverged = named("diverged").and_then(|column| table[column].number(run));
        let iae = named("iae").and_then(|column| table[column].number(run));
        iae.filter(|iae| diverged == Some(0.0) && iae.is_finite())
    };
    let best = (0..runs).filter_map(|run| Some((iae(run)?, run)));
    let best = best.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, run)| run);
    let distance = runs.div_ceil(MOST_RUNS).max(1);
    let drawn = (0..runs).filter(|run| run.is_multiple_of(distance) || Some(*run) == best);
    let drawn = Vec::from_iter(drawn);
    let shown = |cell: &Cell| cell.as_real().map_or_else(|| json::value(cell), number);
    let columns = table.iter().map(|series| {
        let cells = drawn.iter().map(|run| series.cells[*run].as_ref());
        let values = Vec::from_iter(cells.map(|cell| cell.map(shown)));
        json!({"name": series.name, "values": values})
    });
    // Between the index of the run and its metrics.
    let parameters = named("iae").map_or(0, |first| first - 1);
    json!({"runs": runs, "parameters": parameters, "columns": Vec::from_iter(columns)})
}

/// A number with the digits of `f32`, more than a screen shows; null if it is not finite.
fn number(number: f64) -> Value {
    let short = (number as f32).to_string().parse::<f64>().ok();
    json!(short.filter(|number| number.is_finite()))
}

/// Shows a page in the browser, which goes on without this process.
///
/// # Errors
/// The system has no program that opens pages.
fn open(page: &Path) -> Result<()> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_whole_numbers_keep_their_digits() {
        let series = |name: &str, value: Cell| Series::new(name, "", vec![Some(value)]);
        let page = run("a", &[series("time", Cell::Float64(100_000.001))]).unwrap();
        assert_eq!(page["time"], json!([100_000.001]));
        let page = sweep(&[series("seed", Cell::UInt64(u64::MAX))]);
        assert_eq!(page["columns"][0]["values"], json!([u64::MAX]));
    }
}
