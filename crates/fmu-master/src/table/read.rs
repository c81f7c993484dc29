//! Reads tables: of this program, and of other programs if they have a line of names.

use std::io::Cursor;
use std::path::Path;

use anyhow::{Result, ensure};
use fmu_description::Value;

use super::column::Series;
use super::csv::value;
use super::rows::{Rows, time, time_column};

/// Reads a table, as Parquet if the name of the file ends in `.parquet`, else as CSV. `-` is the standard input.
///
/// # Errors
/// The file cannot be read, or is no table; the error does not name the file.
pub fn read(file: &Path) -> Result<Vec<Series>> {
    Rows::open(file)?.into_table()
}

/// Reads a table as [`read`] does, but keeps the fields of CSV as texts, except for the times.
pub(crate) fn read_texts(file: &Path) -> Result<Vec<Series>> {
    open_texts(file)?.into_table()
}

/// Opens a table as [`read_texts`] reads it.
pub(crate) fn open_texts(file: &Path) -> Result<Rows> {
    Rows::open_as(file, text_or_time)
}

/// The columns of the text of CSV, as [`read_texts`] reads them.
pub(crate) fn texts_of(csv: String) -> Result<Vec<Series>> {
    Rows::csv(Box::new(Cursor::new(csv)), text_or_time)?.into_table()
}

fn text_or_time(series: &Series, field: &str) -> Value {
    match &*series.name {
        "time" => value(field),
        _ => Value::String(field.to_owned()),
    }
}

/// The times of a table, its first column.
///
/// # Errors
/// There is none, or it is not in seconds, or a time is not a finite number or is before another, or a column has more or fewer values.
pub fn times(table: &[Series]) -> Result<Vec<f64>> {
    let series = time_column(table)?;
    let mut times = Vec::with_capacity(series.cells.len());
    for (row, cell) in series.cells.iter().enumerate() {
        times.push(time(cell, times.last().copied(), row)?);
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
pub fn rounding(time: f64, first: f64) -> f64 {
    1e-9 * (time - first).abs() + 8.0 * f64::EPSILON * time.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_csv_is_refused_with_what_is_expected() {
        let parse = |text: &'static str| {
            let rows = Rows::csv(Box::new(text.as_bytes()), |_, field| value(field))?;
            rows.into_table()
        };
        for (text, reason) in [
            ("", "it is empty, expected a line of names in CSV"),
            ("\n\n", "it is empty, expected a line of names in CSV"),
            ("time,u\n1\n", "line 2 has 1 fields, expected 2"),
            (",time\n0,1,2\n", "line 2 has 3 fields, expected 2"),
            ("time,u\n0,1\n\n1,\"a\n", "line 4, expected fields of CSV"),
            ("time,u\n0,\"a\"b\n", "line 2, expected fields of CSV"),
            (
                "time;u\r\n0,5;1\r\n",
                "its columns are separated by semicolons, expected commas, and decimal points",
            ),
            (
                "time\tu\n0\t1\n",
                "its columns are separated by tabs, expected commas, and decimal points",
            ),
        ] {
            assert_eq!(parse(text).unwrap_err().to_string(), reason);
        }
        let table = parse("time,u\n\"0,5\",1\n").unwrap();
        let refused = times(&table).unwrap_err().to_string();
        assert_eq!(refused, "the time of row 1 is not a number, but \"0,5\"");
    }

    #[test]
    fn lines_of_other_programs_and_line_feeds_in_quotes_are_read() {
        let text = "\u{feff}time [s],\"a\nb\",c\r\n0,\"x\r\n,\",5\" pipe\r\n\r\n1,,\n\n";
        let rows = Rows::csv(Box::new(text.as_bytes()), |_, field| value(field)).unwrap();
        let table = rows.into_table().unwrap();
        let names = Vec::from_iter(table.iter().map(|series| series.name.as_str()));
        assert_eq!(names, ["time", "a\nb", "c"]);
        let text = |text: &str| Some(Value::String(text.into()));
        assert_eq!(table[1].cells, [text("x\n,"), None]);
        assert_eq!(table[2].cells, [text("5\" pipe"), None]);
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
