//! Tables of results: read from files, and compared.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;

use anyhow::Context;
use fmu_description::{Type, Value};
use fmu_master::curve;
use fmu_master::table::{self, Column, Series, Tolerance};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::arguments::{self, Table};
use crate::error::error;
use crate::values::{Cells, column_into_python, to_python};
use crate::words;

/// The names of items by their numbers.
type Items = BTreeMap<i64, String>;
/// A column that was read: name, unit, items, type, which may be empty, and data.
type ReadColumn<'py> = (String, String, Items, &'py str, Bound<'py, PyAny>);

/// The columns of a table.
#[pyfunction]
pub fn read(py: Python<'_>, file: PathBuf) -> PyResult<Vec<ReadColumn<'_>>> {
    let table = py.detach(|| table::read(&file));
    let table =
        table.with_context(|| format!("{} cannot be read", file.display())).map_err(error)?;
    let columns = table.into_iter().map(|Series { name, unit, cells, items }| {
        let (kind, data) = column_into_python(py, cells)?;
        Ok((name, unit, items, kind, data))
    });
    columns.collect()
}

/// Writes a table, of whose columns there are the type, the items and whether values may be absent besides.
#[pyfunction]
pub fn write(
    py: Python<'_>,
    file: PathBuf,
    table: Table<'_>,
    about: Vec<(String, Items, bool)>,
) -> PyResult<()> {
    let mut columns = Vec::new();
    for ((name, unit, cells), (kind, items, is_masked)) in table.iter().zip(about) {
        let kind = Type::parse(&kind);
        let kind =
            kind.ok_or_else(|| PyTypeError::new_err(format!("{name} has no type of FMI")))?;
        let optional = is_masked || cells.iter().any(Option::is_none);
        columns.push(Column { items, optional, ..Column::new(name, unit, kind) });
    }
    let table = arguments::series(&table)?;
    let written = py.detach(|| {
        let count = table.first().map_or(0, |series| series.cells.len());
        let cell = |row: usize, (column, series): (&Column, &Series)| {
            series.cells.get(row)?.as_ref().map(|value| typed(value, column.kind))
        };
        let rows =
            (0..count).map(|row| columns.iter().zip(&table).map(|both| cell(row, both)).collect());
        table::write(&file, &columns, rows)
    });
    written.map_err(error)
}

/// A value of the widest type of its kind as one of a type.
fn typed(value: &Value, kind: Type) -> Value {
    let typed = match kind {
        Type::String => Some(Value::String(value.to_string())),
        kind if kind.is_float() => {
            let real = value.as_real().or_else(|| value.as_whole().map(|whole| whole as f64));
            real.and_then(|real| Value::real(kind, real))
        }
        kind => value.as_whole().and_then(|whole| Value::whole(kind, whole)),
    };
    typed.unwrap_or_else(|| value.clone())
}

/// The first difference of each variable of two tables, in the order of their times: name, time (s), values and a
/// sentence with these names of the tables.
#[pyfunction]
pub fn compare<'py>(
    py: Python<'py>,
    tables: [Table<'py>; 2],
    names: [String; 2],
    absolute: f64,
    relative: f64,
    held: Vec<String>,
) -> PyResult<Vec<(String, f64, Cells<'py>, String)>> {
    let [a, b] = tables.each_ref().map(arguments::series);
    let (a, b) = (a?, b?);
    let differences = py.detach(|| {
        let tolerance = Tolerance { absolute, relative };
        table::compare([&a, &b], tolerance, |name| held.iter().any(|held| held == name))
    });
    let found = differences.map_err(error)?.into_iter().map(|difference| {
        let text = difference.describe(&names);
        let values =
            difference.values.map(|cell| cell.map(|value| to_python(py, value)).transpose());
        let values = values.into_iter().collect::<PyResult<_>>()?;
        Ok((difference.name, difference.time, values, text))
    });
    found.collect()
}

/// The names of set-points by the names of what follows them, of columns with name, unit and whether they have numbers
/// that vary continuously.
#[pyfunction]
pub fn set_points(columns: Vec<(String, String, bool)>) -> HashMap<String, String> {
    let columns = Vec::from_iter(columns.into_iter().map(|(name, unit, is_continuous)| {
        Column::new(name, unit, if is_continuous { Type::Float64 } else { Type::String })
    }));
    let found = words::set_points(&columns, &curve::of_columns(&columns));
    found.into_iter().map(|(name, of)| (name.to_owned(), of.to_owned())).collect()
}
