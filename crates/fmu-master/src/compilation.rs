//! Compiles FMUs that have sources, but no binary for this machine.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fmu_compile::{CompileControl, compile};
use fmu_description::hash::checksum;
use serde::{Deserialize, Serialize};

/// Whether FMUs that have no binary for this machine are compiled from their sources.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Compilation {
    /// Whether they are; otherwise, they cannot be used.
    pub is_wanted: bool,
    /// A folder in which processes share what they have compiled.
    pub cache: Option<PathBuf>,
}

/// What a compilation leaves out of a build description, one on each line.
const NOTES: &str = "notes.txt";

impl Compilation {
    /// Writes the library with a path such as `binaries/linux64/Pid.so` to the folder of an unpacked FMU. Returns what
    /// was left out of the build description.
    ///
    /// # Errors
    /// The FMU cannot be compiled.
    pub(crate) fn add(&self, fmu: &Path, binary: &str, folder: &Path) -> Result<Vec<String>> {
        // The supervisor kills the group of a worker.
        let control = CompileControl { stays_in_group: true, ..CompileControl::default() };
        let Some(cache) = &self.cache else { return Ok(compile(fmu, folder, &control)?.notes) };
        let hash = checksum(&fs::read(fmu)?);
        let compiled = cache.join(format!("{hash:032x}"));
        if !compiled.exists() {
            fs::create_dir_all(cache)?;
            let new = tempfile::tempdir_in(cache)?;
            let notes = compile(fmu, new.path(), &control)?.notes;
            fs::write(new.path().join(NOTES), notes.join("\n"))?;
            // Another process may have been faster.
            if fs::rename(new.path(), &compiled).is_ok() {
                let _ = new.keep();
            }
        }
        let file = folder.join(binary);
        fs::create_dir_all(file.parent().unwrap_or(folder))?;
        fs::copy(compiled.join(binary), file).context("cannot copy the compiled library")?;
        let notes = fs::read_to_string(compiled.join(NOTES))?;
        Ok(notes.lines().map(str::to_owned).collect())
    }
}
