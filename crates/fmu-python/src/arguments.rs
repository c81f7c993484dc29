//! Arguments of Python as typed jobs and tables.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use fmu_master::job::SystemSource;
use fmu_master::stepped_fmu::Setup;
use fmu_master::table::Series;
use fmu_master::{
    Argument, Compilation, Execution, GivenInput, GivenInputs, Literal, Observation, Overrides,
    Signature, check_factor,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyString};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::Error as ValueError;

use crate::error::FmuError;
use crate::values::{Cells, from_python, literal};

/// Start values by name.
pub type Starts<'py> = Vec<(String, Bound<'py, PyAny>)>;
/// Columns of a table: name, unit and values.
pub type Table<'py> = Vec<(String, String, Cells<'py>)>;

/// A dict of arguments, of which some may be missing or None.
struct Arguments<'a, 'py>(&'a Bound<'py, PyDict>);

impl<'py> Arguments<'_, 'py> {
    fn given(&self, key: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
        Ok(self.0.get_item(key)?.filter(|value| !value.is_none()))
    }

    fn get<T>(&self, key: &str) -> PyResult<Option<T>>
    where
        T: for<'a> FromPyObject<'a, 'py, Error: Into<PyErr>>,
    {
        let given = self.given(key)?;
        given.map(|value| value.extract().map_err(Into::into)).transpose()
    }

    fn number(&self, key: &str) -> PyResult<Option<f64>> {
        let Some(value) = self.given(key)? else { return Ok(None) };
        match value.extract::<f64>() {
            Ok(number) if !value.is_instance_of::<PyBool>() => Ok(Some(number)),
            _ => Err(refused(key, &value, "expected a number")),
        }
    }

    /// An item of an enumeration by its name.
    fn item<T: for<'de> Deserialize<'de>>(&self, key: &str) -> PyResult<Option<T>> {
        let Some(value) = self.given(key)? else { return Ok(None) };
        let Ok(name) = value.extract::<String>() else {
            return Err(refused(key, &value, "expected a string"));
        };
        match T::deserialize(name.as_str().into_deserializer()) {
            Ok(item) => Ok(Some(item)),
            Err(error) => {
                let error: ValueError = error;
                Err(FmuError::new_err(format!("{key} = {name:?}: {error}")))
            }
        }
    }
}

/// The error of an argument of a wrong type.
fn refused(key: &str, value: &Bound<'_, PyAny>, expected: &str) -> PyErr {
    let (kind, shown) = match value.extract::<String>() {
        Ok(text) => ("string".to_owned(), format!("{text:?}")),
        Err(_) => (value.get_type().to_string(), value.to_string()),
    };
    FmuError::new_err(format!("{key} = {shown}: invalid type: {kind} {shown}, {expected}"))
}

/// The source of a system, from a dict with the keys `file`, `text`, `functions`, `starts`, `input`, and those of
/// [`Overrides`].
pub fn system(system: &Bound<'_, PyDict>) -> PyResult<SystemSource> {
    let arguments = Arguments(system);
    let functions = functions(arguments.get("functions")?.unwrap_or_default())?;
    let starts: Option<Starts<'_>> = arguments.get("starts")?;
    let input = arguments.given("input")?;
    let is_file = input.as_ref().is_some_and(|input| input.is_instance_of::<PyString>());
    let (input, given_inputs) = match input {
        None => (None, None),
        Some(file) if is_file => (Some(file.extract::<PathBuf>()?), None),
        Some(given) => (None, Some(inputs(&given.extract()?)?)),
    };
    let real_time = arguments.number("real_time")?;
    if let Some(Err(expected)) = real_time.map(check_factor) {
        let shown = real_time.unwrap_or_default();
        return Err(FmuError::new_err(format!("real_time = {shown}, {expected}")));
    }
    let threads: Option<NonZeroUsize> = arguments.get("threads")?;
    let overrides = Overrides {
        sets: literals(starts.unwrap_or_default())?,
        start: arguments.number("start")?,
        stop: arguments.number("stop")?,
        step: arguments.number("step")?,
        output_step: arguments.number("output_step")?,
        tolerance: arguments.number("tolerance")?,
        solver: arguments.item("solver")?,
        interface: arguments.item("interface")?,
        event_mode: arguments.get("event_mode")?,
        order: arguments.item("order")?,
        algebraic_loops: arguments.item("algebraic_loops")?,
        loop_tolerance: arguments.number("loop_tolerance")?,
        loop_iterations: arguments.get("loop_iterations")?,
        step_tolerance: arguments.number("step_tolerance")?,
        min_step: arguments.number("min_step")?,
        outputs: arguments.get("outputs")?.unwrap_or_default(),
        parameters: arguments.get("parameters")?,
        experiment: arguments.get("experiment")?,
        input,
        given_inputs,
        execution: Execution { real_time, threads },
        observation: observation(&arguments)?,
        save_state: arguments.get("save_state")?,
        load_state: arguments.get("load_state")?,
        compilation: Compilation {
            is_wanted: arguments.get("compile")?.unwrap_or_default(),
            cache: None,
        },
        ..Overrides::default()
    };
    let (file, text) = (arguments.get("file")?.unwrap_or_default(), arguments.get("text")?);
    Ok(SystemSource { file, text, functions, overrides })
}

/// The times of inputs; and of each input its name, unit, values in a row, their shape, and whether its first dimension is
/// the time, None if that follows from the shape.
type Inputs<'py> = (Cells<'py>, Vec<(String, String, Cells<'py>, Vec<usize>, Option<bool>)>);

fn inputs((times, inputs): &Inputs<'_>) -> PyResult<GivenInputs> {
    let inputs = inputs.iter().map(|(name, unit, cells, shape, is_over_time)| {
        let series = column(name, unit, cells)?;
        Ok(GivenInput { series, shape: shape.clone(), is_over_time: *is_over_time })
    });
    Ok(GivenInputs { time: column("time", "s", times)?, inputs: inputs.collect::<PyResult<_>>()? })
}

/// The setup of an FMU that is stepped by hand, from a dict with the keys of [`Setup`].
pub fn setup(setup: &Bound<'_, PyDict>) -> PyResult<Setup> {
    let arguments = Arguments(setup);
    let sizes: Option<Starts<'_>> = arguments.get("sizes")?;
    Ok(Setup {
        file: arguments.get("file")?.unwrap_or_default(),
        name: arguments.get("name")?,
        interface: arguments.item("interface")?,
        start: arguments.number("start")?.unwrap_or_default(),
        tolerance: arguments.number("tolerance")?,
        solver: arguments.item("solver")?,
        sizes: literals(sizes.unwrap_or_default())?,
        compilation: Compilation {
            is_wanted: arguments.get("compile")?.unwrap_or_default(),
            cache: None,
        },
        observation: observation(&arguments)?,
    })
}

fn observation(arguments: &Arguments<'_, '_>) -> PyResult<Observation> {
    let profile = arguments.get("profile")?.unwrap_or_default();
    Ok(Observation { trace: arguments.get("trace")?, profile })
}

/// The names and signatures of functions, of dicts with the keys of [`Signature`].
pub fn functions(given: Vec<(String, Bound<'_, PyDict>)>) -> PyResult<Vec<(String, Signature)>> {
    given.into_iter().map(|(name, function)| Ok((name, signature(&function)?))).collect()
}

fn signature(function: &Bound<'_, PyDict>) -> PyResult<Signature> {
    let arguments = Arguments(function);
    let all = |key: &str| {
        let all: Vec<(String, String, String)> = arguments.get(key)?.unwrap_or_default();
        let all = all.into_iter().map(|(name, of_type, unit)| Argument { name, of_type, unit });
        PyResult::Ok(all.collect())
    };
    let sample_time = arguments.number("sample_time")?;
    Ok(Signature { inputs: all("inputs")?, outputs: all("outputs")?, sample_time })
}

fn literals(starts: Starts<'_>) -> PyResult<Vec<(String, Literal)>> {
    let starts = starts.into_iter().map(|(name, value)| match literal(&value) {
        Ok(value) => Ok((name, value)),
        Err(error) => Err(PyTypeError::new_err(format!("{name}: {}", error.value(value.py())))),
    });
    starts.collect()
}

/// A table.
///
/// # Errors
/// A value is of a type that no variable has.
pub fn series(table: &Table<'_>) -> PyResult<Vec<Series>> {
    table.iter().map(|(name, unit, cells)| column(name, unit, cells)).collect()
}

fn column(name: &str, unit: &str, cells: &Cells<'_>) -> PyResult<Series> {
    let cells = cells.iter().map(|cell| cell.as_ref().map(from_python).transpose());
    let cells: PyResult<_> = cells.collect();
    let cells = cells.map_err(|error| PyTypeError::new_err(format!("{name}: {error}")))?;
    Ok(Series::new(name, unit, cells))
}
