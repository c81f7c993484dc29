//! Writes the results of a sweep as CSV or Parquet, depending on the file extension. The same rows
//! produce the same bytes.
//!
//! - `.csv`: a header and a line for each row, as written by [`Columns`], with line feeds.
//! - `.parquet`: uncompressed; `index` is INT64, numbers are DOUBLE, booleans BOOLEAN, strings UTF-8
//!   BYTE_ARRAY. Columns are required, or optional if a value may be missing.

mod parquet;

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use fmu_file::replace::Replacement;

use crate::{Columns, Error, Row};

#[derive(Clone, Copy)]
enum Format {
    Csv,
    Parquet,
}

impl Format {
    fn of(file: &Path) -> Result<Self, Error> {
        match file.extension().and_then(|extension| extension.to_str()) {
            Some("csv") => Ok(Self::Csv),
            Some("parquet") => Ok(Self::Parquet),
            _ => Err(Error::new(format!(
                "{}: expected a file named .csv or .parquet",
                file.display()
            ))),
        }
    }
}

/// Checks that a table can be written to a file of this name.
///
/// # Errors
/// If its extension is not `.csv` or `.parquet`, or it is a folder, or its folder does not
/// exist.
pub fn check(file: &Path) -> Result<(), Error> {
    Format::of(file)?;
    if file.is_dir() {
        return Err(Error::new(format!(
            "{} is a folder, expected a file",
            file.display()
        )));
    }
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() && !folder.is_dir() => {
            Err(Error::new(format!(
                "cannot write {}: the folder {} does not exist",
                file.display(),
                folder.display()
            )))
        }
        _ => Ok(()),
    }
}

/// Writes rows in order and atomically; an existing file is replaced.
///
/// # Errors
/// If the file has another extension or cannot be written, or a row is an error or does not fit the
/// columns.
pub fn write(
    file: &Path,
    columns: &Columns,
    rows: impl Iterator<Item = Result<Row, Error>>,
) -> Result<(), Error> {
    let format = Format::of(file)?;
    let failed = |error: anyhow::Error| Error::new(format!("{error:#}"));
    let mut output = Replacement::of(file).map_err(failed)?;
    match format {
        Format::Csv => csv(&mut output, file, columns, rows)?,
        Format::Parquet => parquet::write(&mut output, file, columns, rows)?,
    }
    output.finish().map_err(failed)
}

/// The path with a suffix appended to its name.
pub(crate) fn with_suffix(file: &Path, suffix: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

fn csv(
    output: &mut Replacement,
    file: &Path,
    columns: &Columns,
    rows: impl Iterator<Item = Result<Row, Error>>,
) -> Result<(), Error> {
    let mut output = BufWriter::new(output);
    let mut write = |line: String| {
        output
            .write_all(line.as_bytes())
            .map_err(Error::file("write", file))
    };
    write(columns.header())?;
    for row in rows {
        write(columns.line(&row?)?)?;
    }
    output.flush().map_err(Error::file("write", file))
}

#[cfg(test)]
mod tests;
