//! Tables of results: read from files, and compared.

use std::collections::HashMap;
use std::path::PathBuf;

use anyhow::Context;
use fmu_description::Type;
use fmu_master::table::{self, Column, Series, Tolerance};
use fmu_master::trace;
use pyo3::prelude::*;

use crate::arguments::{self, Table};
use crate::error::error;
use crate::values::{Cells, to_python};
use crate::words;

/// The columns of a table that a sweep has written: name, unit and values, None where one is missing.
#[pyfunction]
pub fn read(py: Python<'_>, file: PathBuf) -> PyResult<Vec<(String, String, Cells<'_>)>> {
    let table = py.detach(|| table::read(&file));
    let table =
        table.with_context(|| format!("{} cannot be read", file.display())).map_err(error)?;
    let columns = table.into_iter().map(|Series { name, unit, cells }| {
        let cells =
            cells.into_iter().map(|cell| cell.map(|value| to_python(py, value)).transpose());
        Ok((name, unit, cells.collect::<PyResult<_>>()?))
    });
    columns.collect()
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
    let found = words::set_points(&columns, &trace::of_columns(&columns));
    found.into_iter().map(|(name, of)| (name.to_owned(), of.to_owned())).collect()
}
