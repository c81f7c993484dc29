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
//! The fingerprint is a string of hexadecimal digits that differs between sweeps. The lines of the finished runs, as
//! CSV (see [`table`]), are in any order; a run may appear twice with the same values. A last line without a line feed
//! was torn by a kill; it is cut off when the journal is next opened. A process that writes holds an exclusive lock on
//! the file.
//!
//! # Durability
//!
//! However the process ends, only the runs in progress are lost. Rows are synced to disk in the
//! background when a row is appended, at most once a second, and by [`Journal::keep`]: a power failure
//! loses the rows of about the last second, and these runs are repeated.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Error, Result, ensure};
use fmu_file::replace::Replacement;

use crate::Advice;
use crate::table::{self, Cell, Column, Format};

/// The journal of a sweep, opened and locked.
#[derive(Debug)]
pub struct Journal {
    output: PathBuf,
    format: Format,
    path: PathBuf,
    file: File,
    header: String,
    /// The index of the run, then its values and results.
    columns: Vec<Column>,
    runs: u64,
    /// The runs that have a row.
    done: BTreeSet<u64>,
    length: u64,
    synced: Instant,
    /// The last sync, on a thread of its own, as a disk may take long.
    sync: Option<JoinHandle<io::Result<()>>>,
}

const SYNC_EVERY: Duration = Duration::from_secs(1);

/// The first two lines of a journal.
fn header(fingerprint: &str, columns: &[Column]) -> String {
    format!("# sweep {fingerprint}\n{}", table::header(columns))
}

impl Journal {
    /// Opens or creates the journal of the table `output`, whose first column is the index of the run;
    /// `runs` is their number. The fingerprint is a hexadecimal digest of everything that the rows depend on.
    ///
    /// # Errors
    /// The output is not named `.csv` or `.parquet`; the journal cannot be read or written, is locked by
    /// another process, belongs to another sweep, or has a line that is not a row, or two rows for a run.
    pub fn open(output: &Path, fingerprint: &str, columns: Vec<Column>, runs: u64) -> Result<Self> {
        let format = check(output)?;
        let mut path = output.as_os_str().to_owned();
        path.push(".part");
        let path = PathBuf::from(path);
        let shown = path.display();
        let mut options = OpenOptions::new();
        let file = options.read(true).append(true).create(true).open(&path);
        let file = file.with_context(|| format!("cannot open {shown}"))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let text = format!("{shown} is in use by another process: wait for it, or give ");
                return Err(Advice::AnotherTable.after(text));
            }
            Err(TryLockError::Error(error)) => {
                return Err(error).with_context(|| format!("cannot lock {shown}"));
            }
        }
        let mut journal = Self {
            output: output.to_owned(),
            format,
            header: header(fingerprint, &columns),
            path,
            file,
            columns,
            runs,
            done: BTreeSet::new(),
            length: 0,
            synced: Instant::now(),
            sync: None,
        };
        let text = journal.read()?;
        journal.done = journal.rows(&text, |line| journal.index(line))?.into_keys().collect();
        journal.length = text.len() as u64;
        Ok(journal)
    }

    /// Appends rows, lines of CSV, in one write.
    ///
    /// # Errors
    /// A line does not match the columns or the number of runs, or the lines cannot be written; nothing of them is
    /// left in the file.
    pub fn append(&mut self, lines: &str) -> Result<()> {
        let indices = lines.lines().map(|line| self.index(line)).collect::<Result<Vec<_>>>()?;
        let written = match self.file.write_all(lines.as_bytes()) {
            Ok(()) => {
                self.done.extend(indices);
                self.length += lines.len() as u64;
                self.sync_sometimes()
            }
            Err(error) => {
                let _ = self.file.set_len(self.length); // the first error is more useful
                Err(error)
            }
        };
        written.with_context(|| self.cannot("write"))
    }

    /// The first and the last run, excluded, of each gap between the runs that have a row.
    pub fn missing(&self) -> Vec<(u64, u64)> {
        let mut first = 0;
        let gap = |&run: &u64| (std::mem::replace(&mut first, run + 1), run);
        let gaps = self.done.iter().chain([&self.runs]).map(gap);
        gaps.filter(|(first, end)| first < end).collect()
    }

    /// Starts to sync the file if it is time, unless the last sync is still in progress; returns the error
    /// of the last one.
    fn sync_sometimes(&mut self) -> io::Result<()> {
        let is_busy = self.sync.as_ref().is_some_and(|sync| !sync.is_finished());
        if is_busy || self.synced.elapsed() < SYNC_EVERY {
            return Ok(());
        }
        self.wait()?;
        self.synced = Instant::now();
        let file = self.file.try_clone()?;
        self.sync = Some(thread::spawn(move || file.sync_data()));
        Ok(())
    }

    /// Waits for the last sync.
    fn wait(&mut self) -> io::Result<()> {
        let panicked = |_| Err(io::Error::other("the sync panicked"));
        let sync = self.sync.take();
        sync.map_or(Ok(()), |sync| sync.join().unwrap_or_else(panicked))
    }

    /// Waits until all rows are on disk.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn keep(mut self) -> Result<()> {
        let synced = self.wait().and_then(|()| self.file.sync_data());
        synced.with_context(|| self.cannot("write"))
    }

    /// Writes the table with its rows sorted by run, and removes the journal. Calls `see` for each row, with a
    /// function that reads its cell in a column.
    ///
    /// # Errors
    /// Runs are missing or appear twice with different values, or a file cannot be read or written; the
    /// journal is then kept.
    pub fn finish(mut self, mut see: impl FnMut(&dyn Fn(usize) -> Cell)) -> Result<()> {
        let text = self.read()?;
        // All lines were checked before.
        let first = |line: &str| line.split(',').next()?.parse().ok().filter(|i| *i < self.runs);
        let index = |line: &str| first(line).map_or_else(|| self.index(line), Ok);
        let rows = self.rows(&text, index)?;
        let missing = self.runs - rows.len() as u64;
        ensure!(
            missing == 0,
            "{}: missing runs: {missing} of {}, the first is {}",
            self.path.display(),
            self.runs,
            (0..self.runs).find(|index| !rows.contains_key(index)).unwrap_or_default()
        );
        match self.format {
            Format::Csv => {
                // A row has the same line in the table.
                let mut output = Replacement::new(&self.output)?;
                let mut table = BufWriter::new(&mut output);
                let cannot = || format!("cannot write {}", self.output.display());
                write!(table, "{}", table::header(&self.columns)).with_context(cannot)?;
                for line in rows.values() {
                    let (fields, _) = table::fields(line).unwrap_or_default();
                    see(&|place| {
                        let field = fields.get(place)?.as_deref();
                        self.columns.get(place)?.parse(field).ok().flatten()
                    });
                    writeln!(table, "{line}").with_context(cannot)?;
                }
                table.flush().with_context(cannot)?;
                drop(table);
                output.finish()?;
            }
            Format::Parquet => {
                let rows = rows.values().map(|line| {
                    let (row, _) = table::parse(&self.columns, line)?;
                    see(&|place| row.get(place).cloned().flatten());
                    Ok(row)
                });
                table::write_parquet(&self.output, &self.columns, rows)?;
            }
        }
        self.remove()
    }

    /// Removes the journal.
    ///
    /// # Errors
    /// The file cannot be removed.
    pub fn remove(self) -> Result<()> {
        fs::remove_file(&self.path).with_context(|| self.cannot("remove"))
    }

    /// The whole lines. Cuts the file after the last of them, and writes the header if it was torn or missing.
    fn read(&mut self) -> Result<String> {
        let mut bytes = Vec::new();
        let read = self.file.rewind().and_then(|()| self.file.read_to_end(&mut bytes));
        read.with_context(|| self.cannot("read"))?;
        let header = self.header.as_bytes();
        let cut = if bytes.starts_with(header) {
            let last = bytes.iter().rposition(|&byte| byte == b'\n');
            let length = bytes.len();
            bytes.truncate(last.map_or(0, |last| last + 1));
            if bytes.len() < length { self.file.set_len(bytes.len() as u64) } else { Ok(()) }
        } else if header.starts_with(&bytes) {
            bytes = header.to_vec();
            self.file.set_len(0).and_then(|()| self.file.write_all(&bytes))
        } else {
            let text =
                format!("{} belongs to another sweep: delete it or give ", self.path.display());
            return Err(Advice::AnotherTable.after(text));
        };
        cut.with_context(|| self.cannot("write"))?;
        String::from_utf8(bytes).with_context(|| self.cannot("read"))
    }

    /// The lines of the runs, without duplicates; `index` returns the run of a line.
    fn rows<'a>(
        &self,
        text: &'a str,
        index: impl Fn(&str) -> Result<u64>,
    ) -> Result<BTreeMap<u64, &'a str>> {
        let mut rows = BTreeMap::new();
        let headers = self.header.lines().count();
        for (number, line) in text.lines().enumerate().skip(headers) {
            let mut add = || {
                let index = index(line)?;
                if let Some(other) = rows.insert(index, line) {
                    // Compared as text, since NaN differs from itself.
                    let cells =
                        |line| table::parse(&self.columns, line).map(|row| format!("{row:?}"));
                    ensure!(
                        cells(line)? == cells(other)?,
                        "another row of run {index}, expected the same one"
                    );
                }
                Ok(())
            };
            add().map_err(|error: Error| {
                let advice = "delete the line to repeat the run";
                let file = self.path.display();
                Error::msg(format!("{file}:{}: {error}; {advice}", number + 1))
            })?;
        }
        Ok(rows)
    }

    /// Checks a line, and returns the index of its run.
    fn index(&self, line: &str) -> Result<u64> {
        let (cells, _) = table::parse(&self.columns, line)?;
        let index = cells.first().and_then(|cell| cell.as_ref()?.as_whole());
        let index = index.and_then(|index| u64::try_from(index).ok());
        let (index, runs) = (index.unwrap_or(u64::MAX), self.runs);
        ensure!(index < runs, "{line:?}, expected one of the runs 0..{runs}");
        Ok(index)
    }

    fn cannot(&self, what: &str) -> String {
        format!("cannot {what} {}", self.path.display())
    }
}

/// Checks that a table can be written to a file of this name; returns its format.
fn check(file: &Path) -> Result<Format> {
    let name = file.display();
    let format = Format::from_name(file)
        .with_context(|| format!("{name}: expected a file named .csv or .parquet"))?;
    ensure!(!file.is_dir(), "{name} is a folder, expected a file");
    let folder = file.parent().unwrap_or(Path::new(""));
    ensure!(
        folder.as_os_str().is_empty() || folder.is_dir(),
        "cannot write {name}: the folder {} does not exist",
        folder.display()
    );
    Ok(format)
}

#[cfg(test)]
mod tests {
    use fmu_description::Type;

    use super::*;

    const LINES: [&str; 4] = ["0,0.0,\n", "1,NaN,\"π,\"\"x\"\"\"\n", "2,0.2,linear\n", "3,0.3,#\n"];

    fn columns() -> Vec<Column> {
        let column = |name, kind| Column::new(name, "", kind);
        vec![
            column("index", Type::Int64),
            column("p", Type::Float64),
            column("model", Type::String).optional(),
        ]
    }

    /// A folder, and the paths of the table and the journal in it.
    fn files() -> (tempfile::TempDir, PathBuf, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let [output, part] = ["a.csv", "a.csv.part"].map(|name| folder.path().join(name));
        (folder, output, part)
    }

    fn open(output: &Path) -> Result<Journal, String> {
        let journal = Journal::open(output, "0abc", columns(), 4);
        journal.map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn rows_are_stored_in_the_documented_format_and_sorted_at_the_end() {
        let (folder, output, part) = files();
        let mut journal = open(&output).unwrap();
        for run in [2, 0] {
            journal.append(LINES[run]).unwrap();
        }
        for wrong in ["0\n", "1,0.1,\n4,0.1,\n", "x,0.1,\n", "1,a,\n"] {
            assert!(journal.append(wrong).is_err());
        }
        let expected = "# sweep 0abc\nindex,p,model\n2,0.2,linear\n0,0.0,\n";
        assert_eq!(fs::read_to_string(&part).unwrap(), expected);
        let used = "a.csv.part is in use by another process: wait for it, or give ";
        assert!(open(&output).unwrap_err().ends_with(used));
        let error = journal.finish(|_| ()).unwrap_err().to_string();
        assert!(error.ends_with("a.csv.part: missing runs: 2 of 4, the first is 1"));

        let mut journal = open(&output).unwrap();
        assert_eq!(journal.missing(), [(1, 2), (3, 4)]);
        journal.append(&[3, 1, 3].map(|run| LINES[run]).concat()).unwrap();
        journal.finish(|_| ()).unwrap();
        let table = format!("index,p,model\n{}", LINES.concat());
        assert_eq!(fs::read_to_string(&output).unwrap(), table);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_journal_torn_at_any_byte_is_resumed() {
        let (_folder, output, part) = files();
        let whole = [header("0abc", &columns()), LINES.concat()].concat();
        for cut in 0..=whole.len() {
            let torn = &whole.as_bytes()[..cut];
            fs::write(&part, torn).unwrap();
            let mut journal = open(&output).unwrap();
            let lines = torn.iter().filter(|&&byte| byte == b'\n').count();
            assert_eq!(journal.done.len(), lines.saturating_sub(2), "{cut}");
            for line in &LINES[journal.done.len()..] {
                journal.append(line).unwrap();
            }
            assert_eq!(fs::read_to_string(&part).unwrap(), whole, "{cut}");
        }
    }

    #[test]
    fn another_file_is_not_changed_and_a_damaged_one_is_rejected_with_the_line() {
        let (folder, output, part) = files();
        let (ours, other) = (header("0abc", &columns()), header("0abd", &columns()));
        let foreign = " belongs to another sweep: delete it or give ";
        let damaged = |line, why| format!(":{line}: {why}; delete the line to repeat the run");
        for (text, reason) in [
            (other, foreign.to_owned()),
            ("\n".into(), foreign.to_owned()),
            (ours.clone() + "0,0.1,\n\n1,0.1,\n", damaged(4, "\"\", expected 3 fields")),
            (
                ours.clone() + "0,0.1,\n0,0.2,\n",
                damaged(4, "another row of run 0, expected the same one"),
            ),
            (ours.clone() + "4,0.1,\n", damaged(3, "\"4,0.1,\", expected one of the runs 0..4")),
            (ours + "0,0.\u{0}1,\n", damaged(3, "p is 0.\u{0}1, expected a number")),
        ] {
            fs::write(&part, &text).unwrap();
            let expected = format!("{}{reason}", part.display());
            assert_eq!(open(&output).unwrap_err(), expected);
            assert_eq!(fs::read_to_string(&part).unwrap(), text);
        }
        let error = open(&folder.path().join("a.txt")).unwrap_err();
        assert!(error.ends_with("expected a file named .csv or .parquet"));
    }
}
