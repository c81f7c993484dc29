//! FMUs of a system that must be exported again: they are older than their sources, or missing.

use std::path::{Path, PathBuf};

use fmu_master::{Description, is_fmu};

use crate::ui;

/// The FMUs of a system, or a single one; those of `folder`, if it replaces theirs. None if the system cannot be read,
/// which its worker reports, or is a package of SSP, which has them in it.
pub fn fmus(system: &Path, folder: Option<&Path>) -> Vec<PathBuf> {
    if is_fmu(system) {
        return vec![system.to_owned()];
    }
    if system.extension().is_none_or(|extension| extension != "toml") {
        return Vec::new();
    }
    let Ok(mut description) = Description::read(system) else { return Vec::new() };
    folder.iter().for_each(|folder| description.take_fmus_from(folder));
    description.components.into_iter().map(|component| component.fmu).collect()
}

/// Warns of FMUs that are older than their sources.
pub fn warn(fmus: &[PathBuf]) {
    fmu_build::stale(fmus).iter().for_each(|text| ui::warn(text));
}

/// The end of an error of a system with these FMUs: how to export one that is missing.
pub fn advice(fmus: &[PathBuf]) -> String {
    let mut missing = fmus.iter().filter(|fmu| !fmu.exists());
    let command = missing.find_map(|fmu| fmu_build::export_command(fmu));
    command.map(|command| format!("; `{command}` builds it")).unwrap_or_default()
}
