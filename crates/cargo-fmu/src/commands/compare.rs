//! `cargo fmu compare`: whether two runs have the same results.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use fmu_description::Value;
use fmu_master::table::{self, Cell, Tolerance};

use super::files::stem;
use crate::plot::{CompleteRun, Drawing, Page};
use crate::ui;

/// The results to compare, and how exactly.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Results to compare with, CSV or Parquet
    #[arg(value_name = "REFERENCE")]
    reference: PathBuf,
    /// Results to check, which have all variables of the reference
    #[arg(value_name = "RESULTS")]
    results: PathBuf,
    /// Absolute tolerance of numbers, in the unit of the variable
    #[arg(long, value_name = "TOLERANCE", default_value = "1e-12")]
    absolute: f64,
    /// Tolerance relative to the largest magnitude of the variable in the reference, which is added
    #[arg(long, value_name = "TOLERANCE", default_value = "1e-6")]
    relative: f64,
    /// Sampled variable, whose numbers are not interpolated; may be repeated. Columns of whole numbers, Booleans
    /// and strings never are
    #[arg(long = "hold", value_name = "VARIABLE")]
    held: Vec<String>,
    #[command(flatten)]
    page: Page,
}

/// Prints the first difference; returns whether there is none.
///
/// # Errors
/// The files cannot be read or compared, or the page cannot be written.
pub fn run(args: &CompareArgs, out: &mut impl Write) -> Result<bool> {
    args.page.check()?;
    let read = |file: &Path| {
        let table = table::read(file).and_then(|table| table::times(&table).map(|_| table));
        table.with_context(|| format!("{} cannot be compared", file.display()))
    };
    let files = [&args.reference, &args.results];
    let are_one = files.iter().all(|file| table::is_standard_input(file));
    ensure!(!are_one, "- and - are one standard input, expected a file for one of them");
    let [reference, results] = [read(files[0])?, read(files[1])?];
    for name in &args.held {
        let is_known = reference.iter().any(|series| series.name == *name);
        ensure!(is_known, "--hold {name}: {} has no such variable", files[0].display());
    }
    let tolerance = Tolerance { absolute: args.absolute, relative: args.relative };
    let holds = |name: &str| args.held.iter().any(|held| held == name);
    let shown = files.map(|file| file.display().to_string());
    let differences = table::compare([&reference, &results], tolerance, holds);
    let differences =
        differences.with_context(|| format!("{} and {} cannot be compared", shown[0], shown[1]))?;
    let variables = ui::count(reference.len() - 1, "variable");
    match differences.first() {
        None => {
            let rows = ui::count(reference[0].cells.len(), "row");
            writeln!(out, "the same within the tolerance: {variables}, {rows}")?;
        }
        Some(first) => {
            writeln!(out, "{}", ui::wrapped(&first.describe(&shown)))?;
            let is_name = |cell: &Cell| matches!(cell, Some(Value::String(_)));
            if first.values.iter().flatten().count() == 2
                && is_name(&first.values[0]) != is_name(&first.values[1])
            {
                let numbers = "`cargo fmu simulate --enumerations numbers` writes numbers";
                let text = format!("{} is a name in one file, a number in the other", first.name);
                writeln!(out, "{}", ui::wrapped(&format!("{text}; {numbers}")))?;
            }
            let names = Vec::from_iter(differences.iter().map(|difference| &*difference.name));
            let (differing, names) = (names.len(), names.join(", "));
            let text = format!("different: {differing} of {variables}: {names}");
            writeln!(out, "{}", ui::wrapped(&text))?;
        }
    }
    let stems = files.map(|file| stem(file));
    let [reference_name, name] = if stems[0] == stems[1] { shown } else { stems };
    let draw = || {
        let reference = CompleteRun::of(reference_name, reference)?;
        Drawing::of_runs(CompleteRun::of(name, results)?, vec![reference])
    };
    args.page.draw_runs("Comparison", draw, out)?;
    Ok(differences.is_empty())
}
