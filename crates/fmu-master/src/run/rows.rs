//! Supervisor side of a run: the file with its rows, in which they are kept if the run does not reach its end.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use fmu_description::{Type, Value};
use fmu_file::replace::{Replacement, part_file};

use crate::Row;
use crate::table::{self, Column, Format, ParquetWriter};

/// The rows of a run. Until the run is complete, they are in a CSV file with the suffix `.part`, even if they are also
/// written as Parquet.
pub(super) struct Rows {
    path: PathBuf,
    part: Replacement,
    parquet: Option<ParquetWriter>,
    /// The time and the recorded variables.
    columns: Vec<Column>,
    /// The text that is not yet in the file, and where each of its rows ends, with its time (s).
    text: String,
    ends: Vec<(usize, f64)>,
    /// The number of rows in the file, and the time of the last one (s).
    count: u64,
    last: Option<f64>,
    flushed: Instant,
}

/// The length of the text that is collected before it is written (bytes).
const BUFFER: usize = 1 << 16;

impl Rows {
    /// Starts a file.
    pub(super) fn create(path: &Path, recorded: &[Column]) -> Result<Self> {
        ensure!(!path.is_dir(), "{} is a folder", path.display());
        let mut columns = vec![Column::new("time", "s", Type::Float64)];
        columns.extend_from_slice(recorded);
        let is_parquet =
            Format::from_name(path) == Some(Format::Parquet) && part_file(path).is_some();
        let mut rows = Self {
            path: path.to_owned(),
            part: Replacement::partial(path)?,
            parquet: is_parquet.then(|| ParquetWriter::new(path, &columns)),
            text: table::header(&columns),
            ends: Vec::new(),
            columns,
            count: 0,
            last: None,
            flushed: Instant::now(),
        };
        rows.flush()?;
        Ok(rows)
    }

    pub(super) fn push(&mut self, row: &Row) -> Result<()> {
        let columns = &self.columns[1..];
        table::push_line(&mut self.text, row.cells(columns));
        if let Some(parquet) = &mut self.parquet {
            let time = [Some(Value::Float64(row.time))].into_iter();
            parquet.push(time.chain(row.values(columns)).collect())?;
        }
        self.ends.push((self.text.len(), row.time));
        if self.text.len() >= BUFFER { self.flush() } else { Ok(()) }
    }

    /// Whether something was collected, and nothing written for this long.
    pub(super) fn is_due(&self, period: Duration) -> bool {
        !self.text.is_empty() && self.flushed.elapsed() >= period
    }

    /// Writes what was collected. If the disk is full, the file ends with a whole row.
    pub(super) fn flush(&mut self) -> Result<()> {
        let (text, ends) = (std::mem::take(&mut self.text), std::mem::take(&mut self.ends));
        let before = self.part.length().unwrap_or(0);
        let result = self.part.write_all(text.as_bytes());
        let mut whole = ends.len();
        if result.is_err() {
            let written = self.part.length().unwrap_or(before) - before;
            whole = ends.partition_point(|(end, _)| *end as u64 <= written);
            let end = ends[..whole].last().map_or(0, |(end, _)| *end as u64);
            // A row that is not whole does no harm to those before it.
            let _ = self.part.truncate(before + end);
        }
        self.count += whole as u64;
        self.last = ends[..whole].last().map(|(_, time)| *time).or(self.last);
        self.flushed = Instant::now();
        result.with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Writes what is left, and returns the number of rows.
    pub(super) fn complete(&mut self) -> Result<u64> {
        self.flush()?;
        self.parquet.as_mut().map(ParquetWriter::finish).transpose()?;
        Ok(self.count)
    }

    /// Moves the file into place, unless the table is already there as Parquet.
    pub(super) fn place(self) -> Result<()> {
        if self.parquet.is_some() {
            return Ok(());
        }
        let cannot = || format!("cannot write {}", self.path.display());
        match self.part.keep()? {
            Some(part) => fs::rename(&part, part.with_extension("")).with_context(cannot),
            None => Ok(()),
        }
    }

    /// Whether the file is a device.
    pub(super) fn is_device(&self) -> bool {
        part_file(&self.path).is_none()
    }

    /// Keeps the rows, if there are any, in the file with the suffix `.part` unless it is a device. Returns the file and
    /// the time of the last row (s).
    pub(super) fn keep(mut self) -> Option<(PathBuf, f64)> {
        // As many as the disk has room for.
        let _ = self.flush();
        let last = self.last?;
        let place = part_file(&self.path).unwrap_or(self.path);
        let _ = self.part.keep();
        Some((place, last))
    }
}
