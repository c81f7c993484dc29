//! Calibration files: lookup tables from CSV.

use std::borrow::ToOwned;
use std::error::Error;
use std::fmt;
use std::format;
use std::string::String;
use std::vec::Vec;

use crate::{Table1, Table2};

/// A calibration file that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CalibrationError {
    /// Name of the file.
    pub file: String,
    /// Number of the line, from 1; 0 if it is about the whole file.
    pub line: usize,
    /// Number of the column, from 1; 0 if it is about the whole line.
    pub column: usize,
    /// What is wrong, and what was expected.
    pub what: String,
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { file, line, column, what } = self;
        match (line, column) {
            (0, _) => write!(f, "{file}: {what}"),
            (_, 0) => write!(f, "{file}, line {line}: {what}"),
            _ => write!(f, "{file}, line {line}, column {column}: {what}"),
        }
    }
}

impl Error for CalibrationError {}

impl<const N: usize> Table1<N> {
    /// Reads both columns from a CSV file with `N` lines, `x,y` in each. The `file` is its name for messages, the `text`
    /// what is in it. Fields are separated by commas, semicolons or tabs; a first line without numbers is a header;
    /// empty lines and those that begin with `#` are ignored.
    ///
    /// ```
    /// use control_blocks::Table1;
    ///
    /// let mut torque = Table1::<3>::default();
    /// torque.read_csv("torque.csv", "speed,torque\n0,5\n100,9\n300,1\n")?;
    /// assert_eq!(torque.value(50.0), 7.0);
    /// # Ok::<(), control_blocks::CalibrationError>(())
    /// ```
    ///
    /// # Errors
    /// The file has another size, a field is not a finite number, or x does not increase strictly. Then the table does
    /// not change.
    pub fn read_csv(&mut self, file: &str, text: &str) -> Result<(), CalibrationError> {
        let file = File(file);
        let mut lines = lines(text);
        if lines.first().is_some_and(|first| number(first.cells[0]).is_none()) {
            lines.remove(0);
        }
        file.check_rows(&lines, N)?;
        let (mut x, mut y) = ([0.0; N], [0.0; N]);
        for (i, line) in lines.iter().enumerate() {
            let numbers = file.numbers(line, 0, 2)?;
            (x[i], y[i]) = (numbers[0], numbers[1]);
            file.check_order(line.number, 1, &x[..=i])?;
        }
        (self.x, self.y) = (x, y);
        Ok(())
    }
}

impl<const R: usize, const C: usize> Table2<R, C> {
    /// Reads axes and values from a CSV file: its first line has the axis of the columns after a field that is ignored;
    /// `R` lines follow with the point of the axis of the rows and `C` values. Otherwise as [`Table1::read_csv`].
    ///
    /// ```
    /// use control_blocks::Table2;
    ///
    /// let mut map = Table2::<2, 2>::default();
    /// map.read_csv("map.csv", "speed \\ load; 0; 10\n0; 0; 4\n1; 2; 8\n")?;
    /// assert_eq!(map.value(0.5, 5.0), 3.5);
    /// # Ok::<(), control_blocks::CalibrationError>(())
    /// ```
    ///
    /// # Errors
    /// The file has another size, a field is not a finite number, or an axis does not increase strictly. Then the
    /// table does not change.
    pub fn read_csv(&mut self, file: &str, text: &str) -> Result<(), CalibrationError> {
        let file = File(file);
        let lines = lines(text);
        let Some((header, lines)) = lines.split_first() else {
            return file.error(0, 0, "empty; expected the axis of the columns in its first line");
        };
        let (mut x, mut y, mut z) = ([0.0; R], [0.0; C], [[0.0; C]; R]);
        y.copy_from_slice(&file.numbers(header, 1, C)?);
        for i in 0..C {
            file.check_order(header.number, i + 2, &y[..=i])?;
        }
        file.check_rows(lines, R)?;
        for (i, line) in lines.iter().enumerate() {
            let numbers = file.numbers(line, 0, C + 1)?;
            x[i] = numbers[0];
            z[i].copy_from_slice(&numbers[1..]);
            file.check_order(line.number, 1, &x[..=i])?;
        }
        (self.x, self.y, self.z) = (x, y, z);
        Ok(())
    }
}

/// A line with its number and its fields, at least one.
struct Line<'a> {
    number: usize,
    cells: Vec<&'a str>,
}

/// The lines that are not ignored. The separator is a semicolon or a tab if the first line has one.
fn lines<'a>(text: &'a str) -> Vec<Line<'a>> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let numbered = text.lines().enumerate().map(|(i, line)| (i + 1, line));
    let is_ignored = |line: &str| line.trim().is_empty() || line.trim_start().starts_with('#');
    let content: Vec<_> = numbered.filter(|(_, line)| !is_ignored(line)).collect();
    let has = |separator: &char| content.first().is_some_and(|(_, line)| line.contains(*separator));
    let separator = [';', '\t'].into_iter().find(has).unwrap_or(',');
    let fields = |(number, line): (usize, &'a str)| {
        let cells = line.split(separator).map(str::trim).collect();
        Line { number, cells }
    };
    content.into_iter().map(fields).collect()
}

/// A finite number.
fn number(cell: &str) -> Option<f64> {
    cell.parse().ok().filter(|number: &f64| number.is_finite())
}

/// The name of a file, for its errors.
struct File<'a>(&'a str);

impl File<'_> {
    fn error<T>(
        &self,
        line: usize,
        column: usize,
        what: impl Into<String>,
    ) -> Result<T, CalibrationError> {
        Err(CalibrationError { file: self.0.to_owned(), line, column, what: what.into() })
    }

    fn check_rows(&self, lines: &[Line<'_>], expected: usize) -> Result<(), CalibrationError> {
        match (lines.get(expected), lines.last()) {
            (Some(line), _) => {
                let what = format!("one more row; expected {expected} rows, the size of the table");
                self.error(line.number, 0, what)
            }
            (None, last) if lines.len() < expected => {
                let found = lines.len();
                let what = format!(
                    "the last of {found} rows; expected {expected} rows, the size of the table"
                );
                match last {
                    Some(last) => self.error(last.number, 0, what),
                    None => self.error(
                        0,
                        0,
                        format!("no rows; expected {expected}, the size of the table"),
                    ),
                }
            }
            _ => Ok(()),
        }
    }

    /// The numbers of a line after some fields that are `skipped`.
    fn numbers(
        &self,
        line: &Line<'_>,
        skipped: usize,
        count: usize,
    ) -> Result<Vec<f64>, CalibrationError> {
        let (found, expected) = (line.cells.len(), skipped + count);
        if found != expected {
            return self.error(line.number, 0, format!("{found} columns; expected {expected}"));
        }
        let cells = line.cells.iter().enumerate().skip(skipped);
        let read = |(i, cell): (usize, &&str)| match number(cell) {
            Some(number) => Ok(number),
            None => {
                let what = format!("{cell:?}; expected a number such as 1.5 or -2e-3");
                self.error(line.number, i + 1, what)
            }
        };
        cells.map(read).collect()
    }

    /// Checks the last point of an axis.
    fn check_order(
        &self,
        line: usize,
        column: usize,
        axis: &[f64],
    ) -> Result<(), CalibrationError> {
        match axis {
            [.., before, point] if point <= before => {
                let what = format!(
                    "{point}; expected more than {before}, because an axis increases strictly"
                );
                self.error(line, column, what)
            }
            _ => Ok(()),
        }
    }
}
