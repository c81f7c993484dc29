//! A table of inputs in an FMU, which belongs to an experiment.

use std::path::PathBuf;

use anyhow::{Context, Result};
use fmu_file::archive::Archive;

use crate::table::{self, Series};

/// A table of inputs in an FMU.
#[derive(Debug, Clone)]
pub struct Stimuli {
    /// The file of the FMU.
    pub fmu: PathBuf,
    /// The file in the FMU.
    pub file: String,
}

impl Stimuli {
    /// The columns of the table, whose cells are texts.
    ///
    /// # Errors
    /// It cannot be read, or is no table.
    pub(crate) fn read(&self) -> Result<Vec<Series>> {
        let text = Archive::open_sound(&self.fmu)?.text(&self.file)?;
        table::texts_of(text.with_context(|| format!("there is no {}", self.file))?)
    }
}
