//! Pages with the traces of runs or the metrics of a sweep, which need nothing beside them.

mod decimation;
mod difference;
mod drawing;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use fmu_description::Value as Cell;
use fmu_file::replace::{self, Replacement};
use fmu_master::table::{self, Series};
use serde_json::{Value, json};

pub use self::drawing::{CompleteRun, Drawing};
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

    /// Draws runs over each other.
    ///
    /// # Errors
    /// A row of a run cannot be read, or the page cannot be written or shown.
    pub fn draw_runs(
        &self,
        title: &str,
        runs: impl FnOnce() -> Result<Drawing>,
        out: &mut impl Write,
    ) -> Result<()> {
        let Some(page) = &self.file else { return Ok(()) };
        self.finish(page, RUNS, title, &runs()?.finish()?, out)
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

/// A number with seven digits, more than a screen shows; null if it is not finite.
fn number(number: f64) -> Value {
    json!(format!("{number:.6e}").parse::<f64>().ok().filter(|number| number.is_finite()))
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
    fn whole_numbers_of_a_sweep_keep_their_digits() {
        let page = sweep(&[Series::new("seed", "", vec![Some(Cell::UInt64(u64::MAX))])]);
        assert_eq!(page["columns"][0]["values"], json!([u64::MAX]));
    }
}
