//! The rows of finished runs, stored so that they survive a kill.
//!
//! # File format
//!
//! Until the table is written, the journal is stored next to it under the same name with the suffix
//! `.part`. It is UTF-8 text with a line feed after each line:
//!
//! ```text
//! # sweep 5f1d00c4
//! index,plant.M,iae,settling_time,diverged
//! 0,0.5,0.0123,1.25,false
//! 2,1.5,0.5,,true
//! ```
//!
//! - Line 1: `# sweep ` and the fingerprint, hexadecimal digits that differ between sweeps.
//! - Line 2: the header of a CSV file, [`Columns::header`].
//! - Then a line for each finished run, [`Columns::line`], in any order: the index of the run and its
//!   fields in RFC 4180 format; an empty field is a missing value and `""` an empty string. Numbers
//!   read back to the same bits and may be `inf`, `-inf` or `NaN`; booleans are `true` or `false`.
//!
//! A last line without a line feed was torn by a kill; it is cut off when the journal is next opened.
//! A run may appear twice if both lines have the same values.
//!
//! # Other programs
//!
//! Writers hold an exclusive lock on the file: `File::try_lock`, which is `flock` on Unix
//! (`fcntl.flock(file, LOCK_EX | LOCK_NB)` in Python). A program that collects lines from workers takes
//! the lock, writes the two header lines if the file is empty, cuts off a torn line if there is one,
//! appends whole lines, and closes the file. [`Journal::open`] and [`Journal::finish`] then write the
//! table.
//!
//! # Durability
//!
//! However the process ends, only the runs in progress are lost. Rows are synced to disk in the
//! background when a row is appended, at most once a second, and by [`Journal::sync`]: a power failure
//! loses the rows of about the last second, and these runs are repeated.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::{Columns, Error, Row, table};

/// The journal of a sweep, opened and locked.
#[derive(Debug)]
pub struct Journal {
    output: PathBuf,
    path: PathBuf,
    file: File,
    header: String,
    columns: Columns,
    runs: u64,
    done: BTreeSet<u64>,
    end: Mutex<End>,
}

/// The end of the file.
#[derive(Debug)]
struct End {
    length: u64,
    synced: Instant,
    /// The last sync, on a thread of its own, as a disk may take long.
    sync: Option<JoinHandle<io::Result<()>>>,
}

impl End {
    fn new(length: u64) -> Self {
        Self {
            length,
            synced: Instant::now(),
            sync: None,
        }
    }

    /// Starts to sync the file if it is time, unless the last sync is still in progress; returns the
    /// error of the last one.
    fn sync(&mut self, file: &File) -> io::Result<()> {
        let is_busy = self.sync.as_ref().is_some_and(|sync| !sync.is_finished());
        if is_busy || self.synced.elapsed() < SYNC_EVERY {
            return Ok(());
        }
        self.wait()?;
        self.synced = Instant::now();
        let file = file.try_clone()?;
        self.sync = Some(thread::spawn(move || file.sync_data()));
        Ok(())
    }

    /// Waits for the last sync.
    fn wait(&mut self) -> io::Result<()> {
        match self.sync.take() {
            Some(sync) => sync.join().expect("a sync does not panic"),
            None => Ok(()),
        }
    }
}

const SYNC_EVERY: Duration = Duration::from_secs(1);

impl Journal {
    /// Opens or creates the journal of the table `output`. The fingerprint is a hexadecimal digest of
    /// everything that the rows depend on; `runs` is their number.
    ///
    /// # Errors
    /// If the output is not named `.csv` or `.parquet` or the fingerprint is not hexadecimal; if the
    /// journal cannot be read or written, is locked by another process, belongs to another sweep, or
    /// has a line that is not a row, or two rows for a run.
    pub fn open(
        output: &Path,
        fingerprint: &str,
        columns: Columns,
        runs: u64,
    ) -> Result<Self, Error> {
        table::check(output)?;
        let header = header(fingerprint, &columns)?;
        let path = table::with_suffix(output, ".part");
        let file = OpenOptions::new()
            .read(true)
            .append(true)
            .create(true)
            .open(&path)
            .map_err(Error::file("open", &path))?;
        file.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => Error::new(format!(
                "{} is in use by another process: wait for it, or give another --out",
                path.display()
            )),
            TryLockError::Error(error) => Error::file("lock", &path)(error),
        })?;
        let mut journal = Self {
            output: output.to_owned(),
            path,
            file,
            header,
            columns,
            runs,
            done: BTreeSet::new(),
            end: Mutex::new(End::new(0)),
        };
        journal.cut_torn_line()?;
        let text = journal.read()?;
        let index = |line: &str| Ok(journal.columns.parse(line)?.index);
        journal.done = journal.rows(&text, index)?.into_keys().collect();
        journal.end = Mutex::new(End::new(text.len() as u64));
        Ok(journal)
    }

    /// The runs that were finished when the journal was opened.
    #[must_use]
    pub fn done(&self) -> &BTreeSet<u64> {
        &self.done
    }

    /// The remaining runs of a range, in order.
    pub fn pending(&self, range: Range<u64>) -> impl Iterator<Item = u64> {
        range.filter(|index| !self.done.contains(index))
    }

    /// Appends a row in one write. Threads may call this concurrently.
    ///
    /// # Errors
    /// If the row does not match the columns or the number of runs, or cannot be written; nothing of
    /// it is left in the file.
    pub fn append(&self, row: &Row) -> Result<(), Error> {
        let line = self.columns.line(row)?;
        self.check(row.index)?;
        self.write(&line)
    }

    /// Like [`Journal::append`], for a row that another process has already written as a line.
    ///
    /// # Errors
    /// As for [`Journal::append`].
    pub fn append_line(&self, line: &str) -> Result<(), Error> {
        let row = self.columns.parse(line.trim_end_matches('\n'))?;
        self.check(row.index)?;
        self.write(line)
    }

    fn write(&self, line: &str) -> Result<(), Error> {
        let mut end = self.end.lock().expect("no panic while a row is written");
        if let Err(error) = (&self.file).write_all(line.as_bytes()) {
            let _ = self.file.set_len(end.length); // the first error is more useful
            return Err(Error::file("write", &self.path)(error));
        }
        end.length += line.len() as u64;
        end.sync(&self.file)
            .map_err(Error::file("write", &self.path))
    }

    /// Waits until all rows are on disk.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn sync(&self) -> Result<(), Error> {
        let mut end = self.end.lock().expect("no panic while a row is written");
        end.wait()
            .and_then(|()| self.file.sync_data())
            .map_err(Error::file("write", &self.path))
    }

    /// Writes the table with its rows sorted by run, and removes the journal.
    ///
    /// # Errors
    /// If runs are missing or appear twice with different values, or a file cannot be read or written;
    /// the journal is then kept.
    pub fn finish(self) -> Result<(), Error> {
        let text = self.read()?;
        // The rest of each line is parsed when it is written.
        let rows = self.rows(&text, |line| self.columns.index(line))?;
        let missing = self.runs - rows.len() as u64;
        if missing > 0 {
            let first = (0..self.runs).find(|index| !rows.contains_key(index));
            return Err(Error::new(format!(
                "{}: {missing} of {} runs are missing, the first is {}",
                self.path.display(),
                self.runs,
                first.unwrap_or_default()
            )));
        }
        let rows = rows.values().map(|line| self.columns.parse(line));
        table::write(&self.output, &self.columns, rows)?;
        fs::remove_file(&self.path).map_err(Error::file("remove", &self.path))
    }

    /// Cuts the file after its last whole line, and writes the header if it was torn or missing.
    fn cut_torn_line(&mut self) -> Result<(), Error> {
        let mut bytes = Vec::new();
        self.file
            .read_to_end(&mut bytes)
            .map_err(Error::file("read", &self.path))?;
        let header = self.header.as_bytes();
        let whole = if bytes.starts_with(header) {
            bytes
                .iter()
                .rposition(|&byte| byte == b'\n')
                .map_or(0, |last| last + 1)
        } else if header.starts_with(&bytes) {
            0
        } else {
            return Err(Error::new(format!(
                "{} belongs to another sweep: delete it or give another --out",
                self.path.display()
            )));
        };
        if whole < bytes.len() {
            self.file
                .set_len(whole as u64)
                .map_err(Error::file("write", &self.path))?;
        }
        if whole == 0 {
            self.file
                .write_all(header)
                .map_err(Error::file("write", &self.path))?;
        }
        Ok(())
    }

    fn read(&self) -> Result<String, Error> {
        let mut text = String::new();
        (&self.file)
            .rewind()
            .and_then(|()| (&self.file).read_to_string(&mut text))
            .map_err(Error::file("read", &self.path))?;
        Ok(text)
    }

    /// The lines of the runs, without duplicates; `index` returns the index of the run of a line.
    fn rows<'a>(
        &self,
        text: &'a str,
        index: impl Fn(&str) -> Result<u64, Error>,
    ) -> Result<BTreeMap<u64, &'a str>, Error> {
        let mut rows = BTreeMap::new();
        let headers = self.header.lines().count();
        for (number, line) in text.lines().enumerate().skip(headers) {
            let invalid = |error: Error| {
                let advice = "delete the line to repeat the run";
                let file = self.path.display();
                Error::new(format!("{file}:{}: {error}; {advice}", number + 1))
            };
            let index = index(line).map_err(invalid)?;
            self.check(index).map_err(invalid)?;
            let Some(other) = rows.insert(index, line) else {
                continue;
            };
            // Compared as text, since NaN differs from itself.
            let row = self.columns.parse(line).map_err(invalid)?;
            let other = self.columns.parse(other).map_err(invalid)?;
            if self.columns.line(&row)? != self.columns.line(&other)? {
                let message = format!("another row of run {index}, expected the same one");
                return Err(invalid(Error::new(message)));
            }
        }
        Ok(rows)
    }

    fn check(&self, index: u64) -> Result<(), Error> {
        if index < self.runs {
            return Ok(());
        }
        let runs = self.runs;
        Err(Error::new(format!(
            "run {index}, expected one of 0..{runs}"
        )))
    }
}

/// The first two lines of a journal.
///
/// # Errors
/// If the fingerprint is not hexadecimal.
pub fn header(fingerprint: &str, columns: &Columns) -> Result<String, Error> {
    if fingerprint.is_empty() || !fingerprint.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(Error::new(format!(
            "the fingerprint is {fingerprint:?}, expected hexadecimal digits"
        )));
    }
    Ok(format!("# sweep {fingerprint}\n{}", columns.header()))
}

#[cfg(test)]
mod tests;
