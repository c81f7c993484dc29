//! Writes tables of this program, by the name of the file as CSV or Parquet.

use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use fmu_file::replace::Replacement;

use super::column::{Cell, Column, Format};
use super::{csv, parquet};

/// Writes rows in order and atomically, as Parquet or CSV by the name of the file; an existing file is replaced.
///
/// # Errors
/// The file has another name or cannot be written.
pub fn write(file: &Path, columns: &[Column], rows: impl Iterator<Item = Vec<Cell>>) -> Result<()> {
    let format = Format::from_name(file);
    match format.with_context(|| {
        format!("{}: expected a name that ends in .csv or .parquet", file.display())
    })? {
        Format::Parquet => parquet::write_parquet(file, columns, rows.map(Ok)),
        Format::Csv => {
            let mut output = Replacement::new(file)?;
            let written = write_csv(&mut output, columns, rows);
            written.with_context(|| format!("cannot write {}", file.display()))?;
            output.finish()
        }
    }
}

fn write_csv(
    output: &mut Replacement,
    columns: &[Column],
    rows: impl Iterator<Item = Vec<Cell>>,
) -> Result<()> {
    let (mut output, mut line) = (BufWriter::new(output), csv::header(columns));
    for row in rows {
        output.write_all(line.as_bytes())?;
        line.clear();
        let cells = columns.iter().zip(row);
        csv::push_line(
            &mut line,
            cells.map(|(column, cell)| cell.map(|value| column.named(value))),
        );
    }
    output.write_all(line.as_bytes())?;
    Ok(output.flush()?)
}
