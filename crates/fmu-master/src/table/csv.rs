//! Lines of CSV, written and read.

use std::borrow::Cow;
use std::fmt::Write as _;

use anyhow::{Context, Result, ensure};
use fmu_description::Value;

use super::column::{Cell, Column, boolean};

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

/// The value that a field looks like.
pub(super) fn value(field: &str) -> Value {
    let trimmed = field.trim();
    let whole =
        || trimmed.parse().map(Value::Int64).or_else(|_| trimmed.parse().map(Value::UInt64));
    let value = boolean(trimmed).map(Value::Boolean).or_else(|| whole().ok());
    let value = value.or_else(|| trimmed.parse().map(Value::Float64).ok());
    value.unwrap_or_else(|| Value::String(field.to_owned()))
}

#[cfg(test)]
mod tests {
    use fmu_description::Type;

    use super::*;

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
