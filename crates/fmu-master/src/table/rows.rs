//! Reads the rows of a table one after the other.

use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::path::Path;
use std::vec;

use anyhow::{Context, Error, Result, ensure};
use fmu_description::Value;

use super::column::{Cell, Format, Series, number};
use super::csv::value;
use super::{csv, parquet};

/// The rows of a table, in their order. Those of CSV are read when they are needed.
pub struct Rows {
    /// The names and units of the columns, without cells.
    pub columns: Vec<Series>,
    source: Source,
}

enum Source {
    Csv(Lines),
    Table(Vec<vec::IntoIter<Cell>>),
}

/// The lines of a CSV file.
struct Lines {
    reader: BufReader<Box<dyn Read + Send>>,
    /// The number of fields of a line, and the places of those that are columns.
    fields: usize,
    places: Vec<usize>,
    /// The number of the last line.
    number: usize,
    line: String,
    value: fn(&Series, &str) -> Value,
}

impl Rows {
    /// Opens a table, as Parquet if the name of the file ends in `.parquet`, else as CSV. `-` is the standard input.
    ///
    /// # Errors
    /// The file cannot be read, or is no table; the error does not name the file.
    pub fn open(file: &Path) -> Result<Self> {
        Self::open_as(file, |_, field| value(field))
    }

    /// Opens a table; a function converts the fields of CSV.
    pub(super) fn open_as(file: &Path, value: fn(&Series, &str) -> Value) -> Result<Self> {
        match Format::from_name(file) {
            Some(Format::Parquet) => {
                let table = parquet::read(file)?;
                let places = places(&table);
                let mut table = Vec::from_iter(table.into_iter().map(Some));
                Ok(Self::of(places.iter().filter_map(|place| table[*place].take()).collect()))
            }
            _ if is_standard_input(file) => Self::csv(Box::new(standard_input()?), value),
            _ => Self::csv(Box::new(File::open(file)?), value),
        }
    }

    /// The rows of a table.
    pub fn of(table: Vec<Series>) -> Self {
        let columns = table.into_iter().map(|mut series| {
            let cells = std::mem::take(&mut series.cells);
            (series, cells.into_iter())
        });
        let (columns, cells) = columns.unzip();
        Self { columns, source: Source::Table(cells) }
    }

    /// The rows of CSV.
    pub(super) fn csv(
        reader: Box<dyn Read + Send>,
        value: fn(&Series, &str) -> Value,
    ) -> Result<Self> {
        let reader = BufReader::new(reader);
        let mut lines =
            Lines { reader, fields: 0, places: Vec::new(), number: 0, line: String::new(), value };
        let is_there = lines.next()?;
        ensure!(is_there, "it is empty, expected a line of names in CSV");
        let titles = csv::fields(&lines.line).filter(|(_, rest)| rest.is_empty());
        let (titles, _) = titles.context("line 1, expected names in CSV")?;
        for (separator, name) in [(';', "semicolons"), ('\t', "tabs")] {
            let is_one = matches!(&titles[..], [Some(title)] if title.contains(separator));
            ensure!(
                !is_one,
                "its columns are separated by {name}, expected commas, and decimal points"
            );
        }
        let titles = titles.iter().map(|title| title.as_deref().unwrap_or_default());
        let columns = Vec::from_iter(titles.map(Series::titled));
        let places = places(&columns);
        lines.fields = columns.len();
        let columns = places.iter().map(|place| columns[*place].clone()).collect();
        lines.places = places;
        Ok(Self { columns, source: Source::Csv(lines) })
    }

    /// All rows by column.
    ///
    /// # Errors
    /// A row cannot be read.
    pub fn into_table(self) -> Result<Vec<Series>> {
        let mut table = self.columns.clone();
        for row in self {
            table.iter_mut().zip(row?).for_each(|(series, cell)| series.cells.push(cell));
        }
        Ok(table)
    }

    /// The rows with their times in s, by the first column, which must not fall.
    ///
    /// # Errors
    /// There is no column of times in s.
    pub fn timed(self) -> Result<TimedRows> {
        time_column(&self.columns)?;
        Ok(TimedRows { rows: self, count: 0, before: None })
    }

    fn read(&mut self) -> Result<Option<Vec<Cell>>> {
        let columns = &self.columns;
        match &mut self.source {
            Source::Table(cells) if cells.is_empty() => Ok(None),
            Source::Table(cells) => Ok(cells.iter_mut().map(Iterator::next).collect()),
            Source::Csv(lines) => {
                if !lines.next()? {
                    return Ok(None);
                }
                let Lines { fields: expected, places, number, line, value, .. } = lines;
                let row = csv::fields(line).filter(|(_, rest)| rest.is_empty());
                let (mut row, _) =
                    row.with_context(|| format!("line {number}, expected fields of CSV"))?;
                let found = row.len();
                ensure!(
                    found == *expected,
                    "line {number} has {found} fields, expected {expected}"
                );
                let cells = columns.iter().zip(places).map(|(column, place)| {
                    let field = row[*place].take();
                    field.map(|field| value(column, &field))
                });
                Ok(Some(cells.collect()))
            }
        }
    }
}

impl Iterator for Rows {
    type Item = Result<Vec<Cell>>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}

/// The rows of a table with their times.
pub struct TimedRows {
    rows: Rows,
    count: usize,
    /// The time of the last row (s).
    before: Option<f64>,
}

/// The time (s) of a row, and its cells.
pub type TimedRow = (f64, Vec<Cell>);

impl TimedRows {
    /// Whether a line of CSV is there already, for which the next row need not wait.
    pub(crate) fn has_line(&self) -> bool {
        match &self.rows.source {
            Source::Csv(lines) => lines.reader.buffer().contains(&b'\n'),
            Source::Table(_) => true,
        }
    }

    fn with_time(&mut self, cells: Result<Vec<Cell>>) -> Result<TimedRow> {
        let cells = cells?;
        let time = time(cells.first().unwrap_or(&None), self.before, self.count)?;
        self.before = Some(time);
        self.count += 1;
        Ok((time, cells))
    }
}

impl Iterator for TimedRows {
    type Item = Result<TimedRow>;

    fn next(&mut self) -> Option<Self::Item> {
        let cells = self.rows.next()?;
        Some(self.with_time(cells))
    }
}

/// Whether a file is the standard input; a file of this name is `./-`.
pub fn is_standard_input(file: &Path) -> bool {
    file == Path::new("-")
}

/// The standard input as a file, which reads no further than it is asked to.
///
/// # Errors
/// The process has none.
pub(crate) fn standard_input() -> io::Result<File> {
    #[cfg(unix)]
    let owned = std::os::fd::AsFd::as_fd(&io::stdin()).try_clone_to_owned()?;
    #[cfg(windows)]
    let owned = std::os::windows::io::AsHandle::as_handle(&io::stdin()).try_clone_to_owned()?;
    Ok(File::from(owned))
}

/// The places of the columns of a file. Data frames of pandas are written with their index: the time last, or the numbers
/// of rows without a name.
fn places(columns: &[Series]) -> Vec<usize> {
    let mut places = Vec::from_iter(0..columns.len());
    if let Some(place) = columns.iter().position(|series| series.name == "time") {
        places[..=place].rotate_right(1);
        places.retain(|place| !matches!(&*columns[*place].name, "" | "__index_level_0__"));
    }
    places
}

/// The column of times of a table, its first one.
///
/// # Errors
/// There is none, or it is not in seconds.
pub(super) fn time_column(table: &[Series]) -> Result<&Series> {
    let series = table.first().context("there is no column, expected time")?;
    ensure!(series.name == "time", "the first column is {:?}, expected time", series.name);
    ensure!(matches!(&*series.unit, "" | "s"), "time is in {}, expected s", series.unit);
    Ok(series)
}

/// The time of a row, from 0, which comes after another one.
///
/// # Errors
/// It is not a finite number, or is before the other one.
pub(super) fn time(cell: &Cell, before: Option<f64>, row: usize) -> Result<f64> {
    let time = number(cell).filter(|time| time.is_finite());
    let time = time.with_context(|| {
        let found = cell.as_ref().map_or("empty".into(), |cell| format!("\"{cell}\""));
        format!("the time of row {} is not a number, but {found}", row + 1)
    })?;
    let before = before.unwrap_or(time);
    ensure!(time >= before, "time {time:?} comes after {before:?}, expected rows in order");
    Ok(time)
}

impl Lines {
    /// Reads the next line that is not empty; quotes may have line feeds. Returns whether there is one.
    fn next(&mut self) -> Result<bool> {
        self.line.clear();
        let mut quotes = 0;
        loop {
            let before = self.line.len();
            let read =
                self.reader.read_line(&mut self.line).map_err(|error| match error.kind() {
                    ErrorKind::InvalidData => Error::msg("it is no text in UTF-8, expected CSV"),
                    _ => error.into(),
                })?;
            if read == 0 {
                return Ok(!self.line.is_empty());
            }
            self.number += 1;
            // Other programs begin with a mark, end lines with two characters, and add empty lines.
            if self.number == 1 && self.line.starts_with('\u{feff}') {
                self.line.remove(0);
            }
            if self.line.ends_with("\r\n") {
                let end = self.line.len() - 2;
                self.line.replace_range(end.., "\n");
            }
            let new = self.line[before..].matches('"').count();
            quotes += new;
            if before == 0 && self.line == "\n" {
                self.line.clear();
            } else if quotes % 2 == 0 || (new > 0 && csv::fields(&self.line).is_some()) {
                return Ok(true);
            }
        }
    }
}
