//! Rows of values and their text form, a line of CSV.

use std::borrow::Cow;
use std::collections::HashSet;
use std::fmt::{self, Write as _};

use serde::Deserialize;

use crate::Error;

/// A value of a parameter or a metric.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged, expecting = "expected a number, a boolean or a string")]
pub enum Value {
    /// A number, possibly an integer.
    Number(f64),
    /// A boolean.
    Boolean(bool),
    /// A string, such as the name of an enumeration item.
    Text(String),
}

/// The type of all values of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// [`Value::Number`].
    Number,
    /// [`Value::Boolean`].
    Boolean,
    /// [`Value::Text`].
    Text,
}

impl Value {
    /// The type of this value.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self {
            Self::Number(_) => Kind::Number,
            Self::Boolean(_) => Kind::Boolean,
            Self::Text(_) => Kind::Text,
        }
    }
}

impl fmt::Display for Value {
    /// Writes numbers with the fewest digits that read back to the same bits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number:?}"),
            Self::Boolean(boolean) => write!(f, "{boolean}"),
            Self::Text(text) => f.write_str(text),
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Number => "a number",
            Self::Boolean => "true or false",
            Self::Text => "a string",
        })
    }
}

/// A cell of a table, `None` if the value is missing.
pub type Cell = Option<Value>;

/// The results of a run, in the order of the [`Columns`].
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The index of the run, from 0.
    pub index: u64,
    /// A cell for each column.
    pub cells: Vec<Cell>,
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// The name, as in the header.
    pub name: String,
    /// The type of its values.
    pub kind: Kind,
    /// Whether a value may be missing.
    pub optional: bool,
}

/// The name of the first column, the index of the run.
pub const INDEX: &str = "index";

/// The columns of a table, after the first one, `index`.
///
/// ```
/// use fmu_sweep::{Column, Columns, Kind, Row, Value};
///
/// let column = |name: &str, kind| Column { name: name.into(), kind, optional: true };
/// let columns = Columns::new([column("w[1,2]", Kind::Number), column("model", Kind::Text)])?;
/// assert_eq!(columns.header(), "index,\"w[1,2]\",model\n");
/// let row = Row { index: 7, cells: vec![None, Some(Value::Text("linear".into()))] };
/// assert_eq!(columns.line(&row)?, "7,,linear\n");
/// assert_eq!(columns.parse("7,,linear")?, row);
/// # Ok::<(), fmu_sweep::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Columns(Vec<Column>);

impl Columns {
    /// Creates columns with these names and types.
    ///
    /// # Errors
    /// If a name appears twice, is `index`, is empty, or has a control character.
    pub fn new(columns: impl IntoIterator<Item = Column>) -> Result<Self, Error> {
        let columns: Vec<_> = columns.into_iter().collect();
        let mut names = HashSet::from([INDEX]);
        for Column { name, .. } in &columns {
            if name.is_empty() || name.contains(char::is_control) {
                return Err(Error::new(format!(
                    "a column is named {name:?}, expected a name without control characters"
                )));
            }
            if !names.insert(name) {
                return Err(Error::new(format!(
                    "the column {name} appears twice, expected different names"
                )));
            }
        }
        Ok(Self(columns))
    }

    /// The columns after `index`.
    pub fn iter(&self) -> std::slice::Iter<'_, Column> {
        self.0.iter()
    }

    /// The first line of a CSV file, with its line feed.
    #[must_use]
    pub fn header(&self) -> String {
        let mut header = INDEX.to_owned();
        for column in &self.0 {
            header.push(',');
            push_text(&mut header, &column.name);
        }
        header.push('\n');
        header
    }

    /// Checks that a row fits the columns.
    ///
    /// # Errors
    /// If a value is missing or has the wrong type for its column, or a string has a control character.
    pub fn check(&self, row: &Row) -> Result<(), Error> {
        if row.cells.len() != self.0.len() {
            return Err(Error::new(format!(
                "run {}: a row of {} values, expected {}",
                row.index,
                row.cells.len(),
                self.0.len()
            )));
        }
        for (column, cell) in self.0.iter().zip(&row.cells) {
            match cell {
                None if column.optional => {}
                Some(Value::Text(text)) if text.contains(char::is_control) => {
                    return Err(Error::new(format!(
                        "run {}: {} is {text:?}, expected a string without control characters",
                        row.index, column.name
                    )));
                }
                Some(value) if value.kind() == column.kind => {}
                _ => {
                    let found = cell.as_ref().map_or("empty".into(), Value::to_string);
                    return Err(column.mismatch(row.index, &found));
                }
            }
        }
        Ok(())
    }

    /// The row as a line of CSV, with its line feed. Strings are quoted where RFC 4180 requires it and
    /// if they are empty; a missing value is an empty field.
    ///
    /// # Errors
    /// If the row does not fit the columns, see [`Columns::check`].
    pub fn line(&self, row: &Row) -> Result<String, Error> {
        self.check(row)?;
        // Most cells are numbers, which have less than 24 characters.
        let mut line = String::with_capacity(24 * (row.cells.len() + 1));
        push(&mut line, row.index);
        for cell in &row.cells {
            line.push(',');
            match cell {
                None => {}
                Some(Value::Text(text)) => push_text(&mut line, text),
                Some(value) => push(&mut line, value),
            }
        }
        line.push('\n');
        Ok(line)
    }

    /// The index of the run of a line written by [`Columns::line`].
    pub(crate) fn index(&self, line: &str) -> Result<u64, Error> {
        let (index, _) = line.split_once(',').unwrap_or((line, ""));
        let index = index.parse();
        index.map_err(|_| Error::new(format!("{line:?}, expected the number of a run")))
    }

    /// Parses a line written by [`Columns::line`], without its line feed.
    ///
    /// # Errors
    /// If the line is not CSV, or does not fit the columns.
    pub fn parse(&self, line: &str) -> Result<Row, Error> {
        let damaged = |expected: &str| Error::new(format!("{line:?}, expected {expected}"));
        let fields = split(line).ok_or_else(|| damaged("fields of CSV"))?;
        if fields.len() != self.0.len() + 1 {
            return Err(damaged(&format!("{} fields", self.0.len() + 1)));
        }
        let index = self.index(line)?;
        let cells = self.0.iter().zip(&fields[1..]).map(|(column, field)| {
            let value = match (field, column.kind) {
                (None, _) if column.optional => return Ok(None),
                (None, _) => None,
                (Some(field), Kind::Number) => field.parse().ok().map(Value::Number),
                (Some(field), Kind::Boolean) => field.parse().ok().map(Value::Boolean),
                (Some(field), Kind::Text) => Some(Value::Text(field.clone().into_owned())),
            };
            value
                .ok_or_else(|| column.mismatch(index, field.as_deref().unwrap_or("empty")))
                .map(Some)
        });
        Ok(Row {
            index,
            cells: cells.collect::<Result<_, _>>()?,
        })
    }
}

impl Column {
    fn mismatch(&self, index: u64, found: &str) -> Error {
        Error::new(format!(
            "run {index}: {} is {found}, expected {}",
            self.name, self.kind
        ))
    }
}

fn push(line: &mut String, value: impl fmt::Display) {
    write!(line, "{value}").expect("a String takes any text");
}

/// Appends a string as a field. An empty string is quoted, as an empty field is a missing value.
fn push_text(line: &mut String, text: &str) {
    if text.is_empty() || text.contains([',', '"']) {
        line.push('"');
        line.push_str(&text.replace('"', "\"\""));
        line.push('"');
    } else {
        line.push_str(text);
    }
}

/// The fields of a line, `None` for an empty field without quotes.
fn split(line: &str) -> Option<Vec<Option<Cow<'_, str>>>> {
    let mut fields = Vec::new();
    let mut rest = line;
    loop {
        let (field, after) = match rest.strip_prefix('"') {
            Some(quoted) => {
                let (text, after) = unquote(quoted)?;
                (Some(Cow::Owned(text)), after)
            }
            None => {
                let (plain, after) = rest.split_at(rest.find(',').unwrap_or(rest.len()));
                ((!plain.is_empty()).then_some(Cow::Borrowed(plain)), after)
            }
        };
        fields.push(field);
        match after.strip_prefix(',') {
            Some(after) => rest = after,
            None => return after.is_empty().then_some(fields),
        }
    }
}

/// The text up to the closing quotation mark, and the rest after the mark.
fn unquote(quoted: &str) -> Option<(String, &str)> {
    let mut text = String::new();
    let mut rest = quoted;
    loop {
        let (part, after) = rest.split_once('"')?;
        text.push_str(part);
        match after.strip_prefix('"') {
            Some(after) => {
                text.push('"');
                rest = after;
            }
            None => return Some((text, after)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns() -> Columns {
        let column = |name: &str, kind, optional| Column {
            name: name.into(),
            kind,
            optional,
        };
        Columns::new([
            column("number", Kind::Number, false),
            column("maybe", Kind::Number, true),
            column("boolean", Kind::Boolean, false),
            column("text", Kind::Text, true),
        ])
        .unwrap()
    }

    fn row(number: f64, maybe: Option<f64>, boolean: bool, text: Option<&str>) -> Row {
        Row {
            index: 3,
            cells: vec![
                Some(Value::Number(number)),
                maybe.map(Value::Number),
                Some(Value::Boolean(boolean)),
                text.map(|text| Value::Text(text.into())),
            ],
        }
    }

    #[test]
    fn a_row_is_a_line() {
        let line = |row| columns().line(&row).unwrap();
        assert_eq!(line(row(0.1, None, true, None)), "3,0.1,,true,\n");
        assert_eq!(
            line(row(200.0, Some(1e-300), false, Some("a \"b\", c"))),
            "3,200.0,1e-300,false,\"a \"\"b\"\", c\"\n"
        );
        assert_eq!(
            line(row(f64::NEG_INFINITY, Some(f64::NAN), false, Some(""))),
            "3,-inf,NaN,false,\"\"\n"
        );
    }

    #[test]
    fn every_number_and_text_reads_back_to_the_same_line() {
        let numbers = [
            0.0,
            -0.0,
            0.1 + 0.2,
            1e16,
            5e-324,
            f64::MAX,
            f64::NAN,
            -1e300,
        ];
        let texts = [
            None,
            Some(""),
            Some("\""),
            Some(","),
            Some("π, \"\""),
            Some("3.0"),
        ];
        for number in numbers {
            for text in texts {
                let line = columns().line(&row(number, None, true, text)).unwrap();
                let read = columns().parse(line.trim_end_matches('\n')).unwrap();
                assert_eq!(columns().line(&read).unwrap(), line);
                let Some(Value::Number(read)) = read.cells[0] else {
                    panic!("{line}")
                };
                assert!(read.to_bits() == number.to_bits() || number.is_nan());
            }
        }
    }

    #[test]
    fn a_line_that_does_not_fit_is_rejected_with_the_expectation() {
        for (line, reason) in [
            ("", "\"\", expected 5 fields"),
            ("3,1,,true", "\"3,1,,true\", expected 5 fields"),
            ("3,1,,true,,", "\"3,1,,true,,\", expected 5 fields"),
            (
                "-1,1,,true,",
                "\"-1,1,,true,\", expected the number of a run",
            ),
            (",1,,true,", "\",1,,true,\", expected the number of a run"),
            ("3,x,,true,", "run 3: number is x, expected a number"),
            ("3,,,true,", "run 3: number is empty, expected a number"),
            ("3,1,,yes,", "run 3: boolean is yes, expected true or false"),
            (
                "3,1,,true,\"a",
                "\"3,1,,true,\\\"a\", expected fields of CSV",
            ),
            (
                "3,1,,true,\"a\"b",
                "\"3,1,,true,\\\"a\\\"b\", expected fields of CSV",
            ),
        ] {
            assert_eq!(columns().parse(line).unwrap_err().to_string(), reason);
        }
    }

    #[test]
    fn a_row_that_does_not_fit_is_rejected_with_the_expectation() {
        let mut short = row(1.0, None, true, None);
        short.cells.pop();
        let mut empty = row(1.0, None, true, None);
        empty.cells[2] = None;
        let mut wrong = row(1.0, None, true, None);
        wrong.cells[3] = Some(Value::Number(1.0));
        for (row, reason) in [
            (short, "run 3: a row of 3 values, expected 4"),
            (empty, "run 3: boolean is empty, expected true or false"),
            (wrong, "run 3: text is 1.0, expected a string"),
            (
                row(1.0, None, true, Some("a\nb")),
                "run 3: text is \"a\\nb\", expected a string without control characters",
            ),
        ] {
            assert_eq!(columns().line(&row).unwrap_err().to_string(), reason);
        }
    }

    #[test]
    fn column_names_are_unique_and_have_no_control_characters() {
        let names = |names: &[&str]| {
            Columns::new(names.iter().map(|&name| Column {
                name: name.into(),
                kind: Kind::Number,
                optional: false,
            }))
        };
        assert!(names(&["a", "b"]).is_ok());
        for (wrong, reason) in [
            (
                ["a", "a"],
                "the column a appears twice, expected different names",
            ),
            (
                ["a", "index"],
                "the column index appears twice, expected different names",
            ),
            (
                ["a", ""],
                "a column is named \"\", expected a name without control characters",
            ),
            (
                ["a", "b\n"],
                "a column is named \"b\\n\", expected a name without control characters",
            ),
        ] {
            assert_eq!(names(&wrong).unwrap_err().to_string(), reason);
        }
    }
}
