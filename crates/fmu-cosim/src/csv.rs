//! Results as a CSV file.

mod pending;

use std::fmt::{self, Write as _};
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use fmu_description::VariableType;
use fmu_file::replace::{Replacement, part};

use crate::Column;
use crate::plan::Shown;
use pending::Pending;

/// Writes a CSV file with the header `time [s],plant.theta [rad],...` and numbers that read back
/// exactly. Until it is finished, the file has the suffix `.part`.
pub struct Csv {
    file: Replacement,
    path: PathBuf,
    kinds: Vec<VariableType>,
    /// The rows that are not yet in the file.
    text: String,
    rows: u64,
    /// The time of the last row (s).
    last: f64,
    pending: Option<Pending>,
}

/// Rows of a run that did not reach its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Kept {
    /// The file, which has the suffix `.part` unless it is a device.
    pub file: PathBuf,
    /// The time of the last row (s).
    pub last: f64,
}

impl fmt::Display for Kept {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, last } = self;
        write!(f, "the rows up to t = {last:?} s are in {}", file.display())
    }
}

/// The length of the text that is collected before it is written (bytes).
const BUFFER: usize = 1 << 16;

impl Csv {
    /// Starts a file.
    ///
    /// # Errors
    /// `path` is a folder, its folder does not exist or is not writable, or another process writes the
    /// file.
    pub fn create(path: &Path, columns: &[Column]) -> Result<Self> {
        ensure!(!path.is_dir(), "{} is a folder", path.display());
        let mut csv = Self {
            file: Replacement::part(path)?,
            path: path.to_owned(),
            kinds: columns.iter().map(|column| column.kind).collect(),
            text: "time [s]".to_owned(),
            rows: 0,
            last: f64::NAN,
            pending: None,
        };
        for column in columns {
            let unit = match column.unit.as_str() {
                "" => String::new(),
                unit => format!(" [{unit}]"),
            };
            csv.text.push(',');
            csv.text += &quoted(&format!("{}{unit}", column.name));
        }
        csv.text.push('\n');
        csv.flush()?;
        Ok(csv)
    }

    /// Like [`Csv::create`], but another process can complete the file with [`Csv::rescue`] if this one
    /// crashes. `memory` is a new file for the rows that are not yet written.
    ///
    /// # Errors
    /// See [`Csv::create`]; or `memory` exists or cannot be written.
    pub fn shared(path: &Path, columns: &[Column], memory: &Path) -> Result<Self> {
        let header = Self::create(path, columns)?;
        let length = header.file.length()?;
        let pending = Pending::create(memory, columns.len() + 1, length)
            .with_context(|| format!("cannot write {}", memory.display()))?;
        let kinds: Vec<_> = header.kinds.iter().map(|kind| kind.as_str()).collect();
        fs::write(kinds_of(memory), kinds.join("\n"))
            .with_context(|| format!("cannot write {}", memory.display()))?;
        Ok(Self {
            pending: Some(pending),
            ..header
        })
    }

    /// Adds a row.
    ///
    /// # Errors
    /// The disk is full.
    pub fn push(&mut self, time: f64, row: &[f64]) -> Result<()> {
        if let Some(pending) = &self.pending {
            pending.push(time, row);
        }
        write_row(&mut self.text, &self.kinds, time, row);
        self.rows += 1;
        self.last = time;
        let is_full = self.pending.as_ref().is_some_and(Pending::is_full);
        if is_full || self.text.len() >= BUFFER {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<()> {
        let written = self.file.write_all(self.text.as_bytes());
        written.with_context(|| format!("cannot write {}", self.path.display()))?;
        self.text.clear();
        if let Some(pending) = &self.pending {
            pending.flushed(self.file.length()?);
        }
        Ok(())
    }

    /// Moves the file into place and returns the number of rows.
    ///
    /// # Errors
    /// A row could not be written; no file is left behind.
    pub fn finish(mut self) -> Result<u64> {
        self.flush()?;
        self.file.finish()?;
        Ok(self.rows)
    }

    /// Keeps the rows of a run that failed, if there are any, in the file with the suffix `.part`.
    pub fn keep(mut self) -> Option<Kept> {
        if self.rows == 0 || self.flush().is_err() {
            return None;
        }
        let file = self.file.keep().ok()?;
        Some(Kept {
            file: file.unwrap_or(self.path),
            last: self.last,
        })
    }

    /// Completes the file of a process that has crashed with the rows in its memory; `None` if it
    /// recorded no row. The arguments are those of [`Csv::shared`].
    ///
    /// # Errors
    /// The file cannot be read or written.
    pub fn rescue(path: &Path, memory: &Path) -> io::Result<Option<Kept>> {
        let kept = part(path);
        let Ok(pending) = Pending::open(memory) else {
            // The process crashed while it wrote the header, or before.
            return Ok(None);
        };
        let Some(last) = pending.last() else {
            if let Some(file) = kept {
                fs::remove_file(file)?;
            }
            return Ok(None);
        };
        let file = kept.unwrap_or_else(|| path.to_owned());
        let mut text = String::new();
        let kinds = read_kinds(memory)?;
        pending.rows(|time, row| write_row(&mut text, &kinds, time, row));
        pending.append(&file, &text)?;
        Ok(Some(Kept { file, last }))
    }
}

/// The file with the types of the columns, next to the memory.
fn kinds_of(memory: &Path) -> PathBuf {
    memory.with_extension("kinds")
}

fn read_kinds(memory: &Path) -> io::Result<Vec<VariableType>> {
    let text = fs::read_to_string(kinds_of(memory))?;
    let kinds = text.lines().map(VariableType::parse).collect::<Option<_>>();
    kinds.ok_or_else(|| io::Error::other("the types of the columns are damaged"))
}

fn write_row(text: &mut String, kinds: &[VariableType], time: f64, row: &[f64]) {
    let mut write = || -> fmt::Result {
        write!(text, "{time:?}")?;
        for (kind, value) in kinds.iter().zip(row) {
            write!(text, ",{}", Shown(*kind, *value))?;
        }
        text.write_char('\n')
    };
    // Writing to a string does not fail.
    let _ = write();
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns() -> [Column; 1] {
        [Column {
            name: "a.y".into(),
            unit: "m".into(),
            kind: VariableType::Real,
        }]
    }

    /// What a crashed process leaves behind: a file whose end is torn, and its memory.
    fn crashed(folder: &Path, rows: u32) -> (PathBuf, PathBuf) {
        let (path, memory) = (folder.join("a.csv"), folder.join("rows"));
        let mut csv = Csv::shared(&path, &columns(), &memory).unwrap();
        for k in 0..rows {
            csv.push(f64::from(k), &[0.1 * f64::from(k)]).unwrap();
        }
        csv.file.write_all(b"12.5,1").unwrap();
        std::mem::forget(csv);
        (path, memory)
    }

    #[test]
    fn the_rows_of_a_crashed_process_are_completed() {
        for rows in [1, 20_000, 50_001] {
            let folder = tempfile::tempdir().unwrap();
            let (path, memory) = crashed(folder.path(), rows);
            let kept = Csv::rescue(&path, &memory).unwrap().unwrap();
            assert_eq!(kept.last, f64::from(rows - 1));
            assert_eq!(kept.file, path.with_file_name("a.csv.part"));
            let mut expected = "time [s],a.y [m]\n".to_owned();
            for k in 0..rows {
                write_row(
                    &mut expected,
                    &[VariableType::Real],
                    f64::from(k),
                    &[0.1 * f64::from(k)],
                );
            }
            assert!(fs::read_to_string(kept.file).unwrap() == expected);
            assert!(!path.exists());
        }
    }

    #[test]
    fn nothing_is_left_of_a_run_without_rows() {
        let folder = tempfile::tempdir().unwrap();
        let (path, memory) = crashed(folder.path(), 0);
        assert_eq!(Csv::rescue(&path, &memory).unwrap(), None);
        fs::remove_file(kinds_of(&memory)).unwrap();
        fs::remove_file(memory).unwrap();
        assert!(Csv::create(&path, &columns()).unwrap().keep().is_none());
        drop(Csv::create(&path, &columns()).unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_complete_run_replaces_the_rows_of_a_failed_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let mut failed = Csv::create(&path, &columns()).unwrap();
        failed.push(0.0, &[1.0]).unwrap();
        let text = failed.keep().unwrap().to_string();
        let part = folder.path().join("a.csv.part");
        let expected = format!("the rows up to t = 0.0 s are in {}", part.display());
        assert_eq!(text, expected);
        let mut complete = Csv::create(&path, &columns()).unwrap();
        assert!(Csv::create(&path, &columns()).is_err(), "two writers");
        complete.push(0.5, &[1.0]).unwrap();
        assert_eq!(complete.finish().unwrap(), 1);
        assert!(!part.exists());
        let text = fs::read_to_string(path).unwrap();
        assert_eq!(text, "time [s],a.y [m]\n0.5,1.0\n");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_device_is_an_error_that_names_the_file() {
        let error = Csv::create(Path::new("/dev/full"), &columns()).err();
        let text = format!("{:#}", error.unwrap());
        assert!(text.starts_with("cannot write /dev/full: "), "{text}");
    }
}
