//! Containers: systems as one FMU.

use std::path::PathBuf;

use cargo_fmu::commands::pack::{PackOptions, pack as pack_system};
use fmu_description::FmiVersion;
use pyo3::prelude::*;

use crate::error::{FmuError, error};

/// Writes the container of a system, from its file or a text. Returns notes on what is missing and what hosts cannot do.
#[pyfunction]
pub fn pack(
    py: Python<'_>,
    file: PathBuf,
    text: Option<String>,
    out: PathBuf,
    fmi: &str,
    targets: Vec<String>,
    binaries: Vec<String>,
) -> PyResult<Vec<String>> {
    let version = FmiVersion::ALL.into_iter().find(|version| version.as_str() == fmi);
    let version = version
        .ok_or_else(|| FmuError::new_err(format!("fmi = {fmi:?}, expected \"2.0\" or \"3.0\"")))?;
    let binaries = binaries.iter().map(|binary| binary.parse()).collect::<Result<_, _>>();
    let binaries = binaries.map_err(error)?;
    let options = PackOptions { out: Some(out), version, fmus: None, targets, binaries };
    let packed = py.detach(|| pack_system(&file, text.as_deref(), &options, &|_| ()));
    Ok(packed.map_err(error)?.notes)
}
