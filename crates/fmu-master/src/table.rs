//! Tables of typed columns, and their two formats. The same rows give the same bytes.
//!
//! - CSV: a header such as `time [s],plant.theta [rad]`, then a line for each row, with line feeds. Fields
//!   are quoted as RFC 4180 requires; an empty field is a missing value, and `""` an empty string. Numbers
//!   have the fewest digits that read back to the same bits, or are `inf`, `-inf` or `NaN`; Booleans are
//!   `true` or `false` (also read: `True` and `TRUE`), Enumerations are numbers, and Binaries are hexadecimal.
//! - Parquet: uncompressed, with the same names, and the types of the variables. Columns are required, or
//!   optional if a value may be missing.

mod compare;
mod parquet;
mod read;

use std::borrow::Cow;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Type, Value};
use serde::{Deserialize, Serialize};

pub use compare::{Difference, Tolerance, compare};
pub use parquet::ParquetWriter;
pub use read::{Series, read, times};
pub(crate) use read::{boolean, read_texts, rounding};

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Column {
    /// Its name, such as `component.variable`.
    pub name: String,
    /// Its unit; empty if it has none.
    pub unit: String,
    /// The type of its values.
    pub kind: Type,
    /// Whether a value may be missing.
    pub optional: bool,
}

/// A value of a row; `None` if it is missing.
pub type Cell = Option<Value>;

impl Column {
    /// A column without missing values.
    pub fn new(name: impl Into<String>, unit: impl Into<String>, kind: Type) -> Self {
        Self { name: name.into(), unit: unit.into(), kind, optional: false }
    }

    /// The same column, in which values may be missing.
    pub fn optional(self) -> Self {
        let optional = true;
        Self { optional, ..self }
    }

    /// Its name in a table.
    pub fn title(&self) -> String {
        match self.unit.as_str() {
            "" => self.name.clone(),
            unit => format!("{} [{unit}]", self.name),
        }
    }

    /// Reads a field.
    pub(crate) fn parse(&self, field: Option<&str>) -> Result<Cell> {
        let value = field.and_then(|text| match self.kind {
            kind if kind.is_float() => Value::real(kind, text.trim().parse().ok()?),
            kind => Value::parse(kind, text).or_else(|| match kind {
                Type::Boolean => boolean(text.trim()).map(Value::Boolean),
                _ => None,
            }),
        });
        if value.is_none() && !(field.is_none() && self.optional) {
            let (name, found) = (&self.name, field.unwrap_or("empty"));
            bail!("{name} is {found}, expected {}", expected(self.kind));
        }
        Ok(value)
    }
}

/// What the values of a type are, in words.
pub(crate) fn expected(kind: Type) -> String {
    let (min, max) = kind.range();
    match kind {
        Type::Boolean => "true or false".to_owned(),
        Type::String => "a string".to_owned(),
        Type::Binary => "hexadecimal digits".to_owned(),
        kind if kind.is_float() => "a number".to_owned(),
        _ => format!("a whole number from {min} to {max}"),
    }
}

/// The header of a CSV file, with its line feed.
pub fn header(columns: &[Column]) -> String {
    let titles = columns.iter().map(|column| Some(Value::String(column.title())));
    let mut line = String::new();
    push_line(&mut line, titles);
    line
}

/// Appends a row to the text of a CSV file.
pub fn push_line(text: &mut String, row: impl Iterator<Item = Cell>) {
    for cell in row {
        match cell {
            None => {}
            // An empty string is quoted, as an empty field is a missing value.
            Some(Value::String(value))
                if value.is_empty() || value.contains([',', '"', '\n', '\r']) =>
            {
                text.push('"');
                text.push_str(&value.replace('"', "\"\""));
                text.push('"');
            }
            // As all other values, but quickly; writing to a string does not fail.
            Some(Value::Float64(number)) => _ = write!(text, "{number:?}"),
            Some(value) => _ = write!(text, "{value}"),
        }
        text.push(',');
    }
    text.pop();
    text.push('\n');
}

/// Reads the first row of the text of a CSV file; returns it with the rest of the text.
///
/// # Errors
/// The row is no CSV, or does not fit the columns.
pub fn parse<'a>(columns: &[Column], text: &'a str) -> Result<(Vec<Cell>, &'a str)> {
    let line = || text.lines().next().unwrap_or_default();
    let (fields, rest) =
        fields(text).with_context(|| format!("{:?}, expected fields of CSV", line()))?;
    ensure!(fields.len() == columns.len(), "{:?}, expected {} fields", line(), columns.len());
    let mut cells = Vec::with_capacity(columns.len());
    for (column, field) in columns.iter().zip(&fields) {
        cells.push(column.parse(field.as_deref())?);
    }
    Ok((cells, rest))
}

/// The number of columns for which a row has room at first.
const USUAL_COLUMNS: usize = 16;

/// The fields of a line of CSV, `None` for an empty one without quotes, and the rest after the line; `None` if
/// the line is not CSV.
pub fn fields(mut text: &str) -> Option<(Vec<Option<Cow<'_, str>>>, &str)> {
    let mut fields = Vec::with_capacity(USUAL_COLUMNS);
    loop {
        if let Some(mut rest) = text.strip_prefix('"') {
            let mut field = String::new();
            loop {
                let part;
                (part, text) = rest.split_once('"')?;
                field.push_str(part);
                match text.strip_prefix('"') {
                    Some(after) => rest = after,
                    None => break,
                }
                field.push('"');
            }
            fields.push(Some(field.into()));
        } else {
            let end = text.bytes().position(|byte| matches!(byte, b',' | b'\n'));
            let (field, rest) = text.split_at(end.unwrap_or(text.len()));
            fields.push((!field.is_empty()).then_some(field.into()));
            text = rest;
        }
        match text.as_bytes() {
            [b',', ..] => text = &text[1..],
            [b'\n', ..] => return Some((fields, &text[1..])),
            [] => return Some((fields, text)),
            _ => return None,
        }
    }
}

/// The format of a table, by the name of its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "see the module")]
pub enum Format {
    Csv,
    Parquet,
}

impl Format {
    /// The format of a file name, `.csv` or `.parquet`; `None` if it has another extension.
    pub fn of(file: &Path) -> Option<Self> {
        match &*file.extension()?.to_str()?.to_ascii_lowercase() {
            "csv" => Some(Self::Csv),
            "parquet" => Some(Self::Parquet),
            _ => None,
        }
    }
}

/// Writes rows as Parquet, in order and atomically; an existing file is replaced.
///
/// # Errors
/// The file cannot be written, or a row is an error.
pub fn write_parquet(
    file: &Path,
    columns: &[Column],
    rows: impl Iterator<Item = Result<Vec<Cell>>>,
) -> Result<()> {
    let mut writer = ParquetWriter::new(file, columns);
    for row in rows {
        writer.push(row?)?;
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parquet_reads_back_with_types_and_missing_values() {
        let values = [
            Value::Float64(0.1 + 0.2),
            Value::Float32(0.1),
            Value::Int8(-1),
            Value::UInt8(u8::MAX),
            Value::Int16(-2),
            Value::UInt16(u16::MAX),
            Value::Int32(i32::MIN),
            Value::UInt32(u32::MAX),
            Value::Int64(i64::MIN),
            Value::UInt64(u64::MAX),
            Value::Boolean(true),
            Value::String("π".into()),
            Value::Binary(vec![0, 255]),
        ];
        let names = Vec::from_iter(values.iter().map(|value| format!("a.{:?}", value.of_type())));
        let columns = names.iter().zip(&values);
        let columns = columns.map(|(name, v)| Column::new(name, "m/s", v.of_type()).optional());
        let columns = Vec::from_iter(columns);
        let rows = [values.clone().map(Some).to_vec(), vec![None; values.len()]];
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.parquet");
        write_parquet(&file, &columns, rows.into_iter().map(Ok)).unwrap();
        let expected = names.into_iter().zip(values).map(|(name, value)| {
            let (unit, cells) = ("m/s".into(), vec![Some(value), None]);
            Series { name, unit, cells }
        });
        assert_eq!(read(&file).unwrap(), Vec::from_iter(expected));
        std::fs::write(&file, "PAR1").unwrap();
        read(&file).unwrap_err();
    }

    /// `tests/test_native.py` compares values of all types in both formats.
    #[test]
    fn every_value_reads_back_and_an_empty_string_is_not_missing() {
        let text = |text: &str| Value::String(text.into());
        for (value, field) in [
            (Value::Float64(0.1 + 0.2), "0.30000000000000004"),
            (Value::Float64(-0.0), "-0.0"),
            (Value::Float64(5e-324), "5e-324"),
            (Value::Float64(f64::NEG_INFINITY), "-inf"),
            (Value::Binary(vec![0, 255]), "00ff"),
            (text(""), "\"\""),
            (text("3.0"), "3.0"),
            (text("π, \"\"\r\n"), "\"π, \"\"\"\"\r\n\""),
        ] {
            let column = Column::new("a", "", value.of_type());
            let columns = [column.clone(), column.optional()];
            let mut line = String::new();
            push_line(&mut line, [Some(value.clone()), None].into_iter());
            assert_eq!(line, format!("{field},\n"));
            let cells = parse(&columns, &line).unwrap();
            assert_eq!(cells, (vec![Some(value), None], ""));
        }
        let columns = [Column::new("a", "", Type::Boolean)];
        for (field, value) in [("True", true), ("FALSE", false), ("1", true)] {
            let cells = parse(&columns, field).unwrap().0;
            assert_eq!(cells, [Some(Value::Boolean(value))]);
        }
        let columns = [("a", Type::Float64), ("b", Type::Boolean), ("c", Type::Int8)];
        let columns = columns.map(|(name, kind)| Column::new(name, "", kind));
        for (line, reason) in [
            ("1,true", "\"1,true\", expected 3 fields"),
            ("x,true,1", "a is x, expected a number"),
            ("1,,1", "b is empty, expected true or false"),
            ("1,true,128", "c is 128, expected a whole number from -128 to 127"),
            ("1,\"a", "\"1,\\\"a\", expected fields of CSV"),
            ("1,\"a\"b", "\"1,\\\"a\\\"b\", expected fields of CSV"),
        ] {
            assert_eq!(parse(&columns, line).unwrap_err().to_string(), reason);
        }
    }
}
