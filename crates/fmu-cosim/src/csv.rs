//! Results as a CSV file.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use fmu_file::replace::Replacement;

use crate::Column;

/// Writes a CSV file with the header `time [s],plant.theta [rad],...` and numbers that read back
/// exactly. The file appears under its name only once it is finished.
pub struct Csv {
    file: BufWriter<Replacement>,
    path: PathBuf,
    columns: Vec<Column>,
    failed: Option<std::io::Error>,
    rows: u64,
}

impl Csv {
    /// Starts a file.
    ///
    /// # Errors
    /// `path` is a folder, or its folder is not writable.
    pub fn create(path: &Path, columns: &[Column]) -> Result<Self> {
        ensure!(!path.is_dir(), "{} is a folder", path.display());
        let mut csv = Self {
            file: BufWriter::new(Replacement::of(path)?),
            path: path.to_owned(),
            columns: columns.to_vec(),
            failed: None,
            rows: 0,
        };
        let mut header = "time [s]".to_owned();
        for column in columns {
            let unit = match column.unit.as_str() {
                "" => String::new(),
                unit => format!(" [{unit}]"),
            };
            header += &format!(",{}", quoted(&format!("{}{unit}", column.name)));
        }
        let written = writeln!(csv.file, "{header}");
        csv.keep(written);
        Ok(csv)
    }

    /// Adds a row; errors surface in [`Csv::finish`].
    pub fn push(&mut self, time: f64, row: &[f64]) {
        let written = self.write(time, row);
        self.keep(written);
        self.rows += 1;
    }

    fn write(&mut self, time: f64, row: &[f64]) -> std::io::Result<()> {
        write!(self.file, "{time:?}")?;
        for (column, value) in self.columns.iter().zip(row) {
            write!(self.file, ",{}", column.show(*value))?;
        }
        self.file.write_all(b"\n")
    }

    fn keep(&mut self, written: std::io::Result<()>) {
        if let Err(error) = written {
            self.failed.get_or_insert(error);
        }
    }

    /// Moves the file into place and returns the number of rows.
    ///
    /// # Errors
    /// A row could not be written; no file is left behind.
    pub fn finish(self) -> Result<u64> {
        let cannot = || format!("cannot write {}", self.path.display());
        if let Some(error) = self.failed {
            return Err(error).with_context(cannot);
        }
        let file = self
            .file
            .into_inner()
            .map_err(|error| error.into_error())
            .with_context(cannot)?;
        file.finish()?;
        Ok(self.rows)
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}
