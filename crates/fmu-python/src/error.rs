//! Errors of the master as exceptions of Python.

use fmu_master::{FailedCall, RunError};
use pyo3::prelude::*;

use crate::words;

pyo3::import_exception!(fmu_master.result, FmuError);

/// The exception of an error of the master.
pub fn error(error: anyhow::Error) -> PyErr {
    to_exception(*RunError::new(error, Vec::new()))
}

/// The exception of an error.
pub fn to_exception(error: RunError) -> PyErr {
    FmuError::new_err(error_arguments(error))
}

/// The first arguments of `FmuError`: text, component, function and time (s).
pub fn error_arguments(error: RunError) -> (String, Option<String>, Option<String>, Option<f64>) {
    let advice = error.advice.as_ref().map(words::advice).unwrap_or_default();
    let (text, time) = (format!("{error}{advice}"), error.time);
    match error.call {
        None => (text, None, None, None),
        Some(FailedCall { component, function, .. }) => {
            (text, Some(component), Some(function), time)
        }
    }
}
