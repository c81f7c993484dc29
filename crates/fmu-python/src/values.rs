//! Values between Python and Rust: results as columns of bytes, which NumPy reads as they are, single values, and
//! literals.

use fmu_description::{Type, Value};
use fmu_master::table::Cell;
use fmu_master::{Column, Literal, Row};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes, PyFloat, PyList, PyString};

/// The values of a column: numbers and Booleans in the order of bytes of this machine, or texts and Binaries.
#[derive(Default)]
struct Data {
    bytes: Vec<u8>,
    others: Vec<Value>,
    /// For each value, whether it is absent; empty of a column in which none may be.
    absent: Vec<u8>,
}

/// The rows of a run.
#[derive(Default)]
pub struct Columns {
    times: Vec<f64>,
    data: Vec<Data>,
}

impl Columns {
    /// Adds a row with these columns.
    pub fn push(&mut self, columns: &[Column], row: &Row) {
        self.data.resize_with(columns.len(), Data::default);
        self.times.push(row.time);
        let values = columns.iter().zip(row.values(columns));
        for (data, (column, cell)) in self.data.iter_mut().zip(values) {
            if column.optional {
                data.absent.push(cell.is_none().into());
            }
            data.push(match cell {
                // As FMI 2.0 accesses the number of an item.
                Some(Value::Int32(item)) if column.kind == Type::Enumeration => {
                    Value::Int64(item.into())
                }
                Some(value) => value,
                None => Value::zero(column.kind),
            });
        }
    }

    /// The columns of Python: name, unit, type, data, and which values are absent, of each.
    pub fn into_python<'py>(
        self,
        py: Python<'py>,
        columns: &[Column],
    ) -> PyResult<Bound<'py, PyList>> {
        let mut times = Data::default();
        self.times.into_iter().for_each(|time| times.push(Value::Float64(time)));
        let time = Column::new("time", "s", Type::Float64);
        let mut data = self.data;
        data.resize_with(columns.len(), Data::default);
        let all = [&time].into_iter().chain(columns).zip([times].into_iter().chain(data));
        let list = PyList::empty(py);
        for (Column { name, unit, kind, optional, .. }, mut data) in all {
            let absent = std::mem::take(&mut data.absent);
            let absent = optional.then(|| PyByteArray::new(py, &absent));
            list.append((name, unit, kind.as_str(), data.into_python(py, *kind)?, absent))?;
        }
        Ok(list)
    }
}

/// Defines how numbers are added.
macro_rules! push {
    ($($real:ident: $real_type:ty),*; $($whole:ident: $whole_type:ty),*; $($_0:tt)*) => {
        impl Data {
            fn push(&mut self, value: Value) {
                match value {
                    $(Value::$real(number) => self.bytes.extend_from_slice(&number.to_ne_bytes()),)*
                    $(Value::$whole(number) => self.bytes.extend_from_slice(&number.to_ne_bytes()),)*
                    Value::Enumeration(item) => self.bytes.extend_from_slice(&item.to_ne_bytes()),
                    Value::Boolean(value) | Value::Clock(value) => self.bytes.push(value.into()),
                    other => self.others.push(other),
                }
            }
        }
    };
}
fmu_description::types!(push!);

/// The values of a column that was read: their type and data if they have one type and none is missing, else no type and
/// a list.
pub fn column_into_python(py: Python<'_>, cells: Vec<Cell>) -> PyResult<(&str, Bound<'_, PyAny>)> {
    let kind = cells.first().and_then(Option::as_ref).map(Value::of_type);
    let is_one = |cell: &Cell| cell.as_ref().map(Value::of_type) == kind;
    if let Some(kind) = kind
        && cells.iter().all(is_one)
    {
        let mut data = Data::default();
        cells.into_iter().flatten().for_each(|value| data.push(value));
        return Ok((kind.as_str(), data.into_python(py, kind)?));
    }
    let cells = cells.into_iter().map(|cell| cell.map(|value| to_python(py, value)).transpose());
    Ok(("", PyList::new(py, cells.collect::<PyResult<Vec<_>>>()?)?.into_any()))
}

impl Data {
    fn into_python(self, py: Python<'_>, kind: Type) -> PyResult<Bound<'_, PyAny>> {
        if !matches!(kind, Type::String | Type::Binary) {
            return Ok(PyByteArray::new(py, &self.bytes).into_any());
        }
        let others = self.others.into_iter().map(|value| to_python(py, value));
        Ok(PyList::new(py, others.collect::<PyResult<Vec<_>>>()?)?.into_any())
    }
}

/// A value of the widest type of its kind.
pub fn from_python(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    // The usual case.
    if let Ok(value) = value.cast::<PyFloat>() {
        return Ok(Value::Float64(value.value()));
    }
    if let Ok(value) = value.extract() {
        return Ok(Value::Boolean(value));
    }
    if let Ok(value) = value.extract() {
        return Ok(Value::Int64(value));
    }
    if let Ok(value) = value.extract() {
        return Ok(Value::UInt64(value));
    }
    if let Ok(value) = value.extract() {
        return Ok(Value::Float64(value));
    }
    match value.extract() {
        Ok(text) => Ok(Value::String(text)),
        Err(_) => value.extract().map(Value::Binary).map_err(|_| {
            PyTypeError::new_err(format!("{value} is not a number, Boolean, string or bytes"))
        }),
    }
}

/// A value of Python.
pub fn to_python(py: Python<'_>, value: Value) -> PyResult<Bound<'_, PyAny>> {
    Ok(match value {
        Value::Boolean(value) | Value::Clock(value) => {
            value.into_pyobject(py)?.to_owned().into_any()
        }
        Value::String(text) => PyString::new(py, &text).into_any(),
        Value::Binary(bytes) => PyBytes::new(py, &bytes).into_any(),
        value => match value.as_whole() {
            Some(whole) => whole.into_pyobject(py)?.into_any(),
            None => value.as_real().into_pyobject(py)?.into_any(),
        },
    })
}

/// The values of a column, None where one is missing.
pub type Cells<'py> = Vec<Option<Bound<'py, PyAny>>>;

/// A literal: a value, or an array as a list.
pub fn literal(value: &Bound<'_, PyAny>) -> PyResult<Literal> {
    if let Ok(list) = value.cast::<PyList>() {
        let values = list.iter().map(|value| literal(&value));
        return Ok(Literal::Array(values.collect::<PyResult<_>>()?));
    }
    Ok(match from_python(value)? {
        Value::Boolean(value) => Literal::Boolean(value),
        Value::String(text) => Literal::Text(text),
        Value::Binary(bytes) => Literal::Bytes(bytes),
        number => match (number.as_whole(), number.as_real()) {
            (Some(whole), _) => Literal::Integer(whole),
            (_, Some(real)) => Literal::Real(real),
            _ => {
                let text = format!("{value} is not a number, Boolean or string");
                return Err(PyTypeError::new_err(text));
            }
        },
    })
}
