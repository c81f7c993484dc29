//! Reads tables: of this program, and of other programs if they have a line of names.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use fmu_description::Value;

use super::column::{Format, Series, boolean};
use super::{csv, parquet};

/// Reads a table, as Parquet if the name of the file ends in `.parquet`, else as CSV.
///
/// # Errors
/// The file cannot be read, or is no table; the error does not name the file.
pub fn read(file: &Path) -> Result<Vec<Series>> {
    read_as(file, |_, field| value(field))
}

/// Reads a table as [`read`] does, but keeps the fields of CSV as texts, except for the times.
pub(crate) fn read_texts(file: &Path) -> Result<Vec<Series>> {
    read_as(file, |series, field| match &*series.name {
        "time" => value(field),
        _ => Value::String(field.to_owned()),
    })
}

fn read_as(file: &Path, value: impl Fn(&Series, &str) -> Value) -> Result<Vec<Series>> {
    let mut table = match Format::from_name(file) {
        Some(Format::Parquet) => parquet::read(file)?,
        _ => {
            let text = String::from_utf8(fs::read(file)?).ok();
            parse(&text.context("it is no text in UTF-8, expected CSV")?, value)?
        }
    };
    // Data frames of pandas are written with their index: the time last, or the numbers of rows without a name.
    if let Some(place) = table.iter().position(|series| series.name == "time") {
        table[..=place].rotate_right(1);
        table.retain(|series| !matches!(&*series.name, "" | "__index_level_0__"));
    }
    Ok(table)
}

fn parse(text: &str, value: impl Fn(&Series, &str) -> Value) -> Result<Vec<Series>> {
    // Other programs begin with a mark, end lines with two characters, and add empty lines.
    let text = text.trim_start_matches('\u{feff}').replace("\r\n", "\n");
    ensure!(!text.trim().is_empty(), "it is empty, expected a line of names in CSV");
    let (titles, mut rest) =
        csv::fields(text.trim_end_matches('\n')).context("line 1, expected names in CSV")?;
    for (separator, name) in [(';', "semicolons"), ('\t', "tabs")] {
        let is_one = matches!(&titles[..], [Some(title)] if title.contains(separator));
        ensure!(
            !is_one,
            "its columns are separated by {name}, expected commas, and decimal points"
        );
    }
    let titles = titles.iter().map(|title| title.as_deref().unwrap_or_default());
    let mut table = Vec::from_iter(titles.map(Series::titled));
    let mut line = 1;
    while !rest.is_empty() {
        line += 1;
        let row;
        (row, rest) =
            csv::fields(rest).with_context(|| format!("line {line}, expected fields of CSV"))?;
        let (found, expected) = (row.len(), table.len());
        ensure!(found == expected, "line {line} has {found} fields, expected {expected}");
        for (series, field) in table.iter_mut().zip(row) {
            let cell = field.map(|field| value(series, &field));
            series.cells.push(cell);
        }
    }
    Ok(table)
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

/// The times of a table, its first column.
///
/// # Errors
/// There is none, or it is not in seconds, or a time is not a finite number or is before another, or a column has more or fewer values.
pub fn times(table: &[Series]) -> Result<Vec<f64>> {
    let series = table.first().context("there is no column, expected time")?;
    ensure!(series.name == "time", "the first column is {:?}, expected time", series.name);
    ensure!(matches!(&*series.unit, "" | "s"), "time is in {}, expected s", series.unit);
    let mut times = Vec::with_capacity(series.cells.len());
    for row in 0..series.cells.len() {
        let time = series.number(row).filter(|time| time.is_finite());
        let time = time.with_context(|| {
            let found =
                series.cells[row].as_ref().map_or("empty".into(), |cell| format!("\"{cell}\""));
            format!("the time of row {} is not a number, but {found}", row + 1)
        })?;
        let before = times.last().copied().unwrap_or(time);
        ensure!(time >= before, "time {time:?} comes after {before:?}, expected rows in order");
        times.push(time);
    }
    ensure!(!times.is_empty(), "there is no row, expected at least one");
    for Series { name, cells, .. } in table {
        let (found, rows) = (cells.len(), times.len());
        ensure!(found == rows, "{name} has {found} values, expected {rows}, as time has");
    }
    Ok(times)
}

/// How far apart times are that are the same but for rounding: what adds up from the first time on, and the
/// digits of a time that is large itself, such as one since 1970.
pub(crate) fn rounding(time: f64, first: f64) -> f64 {
    1e-9 * (time - first).abs() + 8.0 * f64::EPSILON * time.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_csv_is_refused_with_what_is_expected() {
        for (text, reason) in [
            ("", "it is empty, expected a line of names in CSV"),
            (
                "time;u\r\n0,5;1\r\n",
                "its columns are separated by semicolons, expected commas, and decimal points",
            ),
            (
                "time\tu\n0\t1\n",
                "its columns are separated by tabs, expected commas, and decimal points",
            ),
        ] {
            assert_eq!(parse(text, |_, field| value(field)).unwrap_err().to_string(), reason);
        }
        let table = parse("time,u\n\"0,5\",1\n", |_, field| value(field)).unwrap();
        let refused = times(&table).unwrap_err().to_string();
        assert_eq!(refused, "the time of row 1 is not a number, but \"0,5\"");
    }

    #[test]
    fn fields_of_csv_have_the_type_that_they_look_like() {
        for (field, expected) in [
            ("True", Value::Boolean(true)),
            (" FALSE", Value::Boolean(false)),
            ("-9223372036854775808", Value::Int64(i64::MIN)),
            ("18446744073709551615", Value::UInt64(u64::MAX)),
            ("18446744073709551616", Value::Float64(18_446_744_073_709_551_616.0)),
            ("1.0", Value::Float64(1.0)),
            ("TRue", Value::String("TRue".into())),
        ] {
            assert_eq!(value(field), expected);
        }
    }
}
