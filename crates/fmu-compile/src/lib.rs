//! Compiles the sources of FMUs from any vendor, of FMI 2.0 and 3.0, with the system's compiler for C or C++.
//!
//! The sources are untrusted: paths stay in the FMU, options of a build description that could run programs or write
//! files are refused, and the compiler has limits. Nothing that was compiled is run.
#![forbid(unsafe_code)]

mod compiler;
mod description;
mod error;
mod options;
mod workshop;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fmu_description::xml;
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::{self, Archive, MODEL_DESCRIPTION, Packed};

use crate::description::Recipes;
use crate::workshop::Workshop;

pub use crate::compiler::CompileControl;
pub use crate::description::platform;
pub use crate::error::{CompileError, MESSAGE_LINES};

/// The libraries of an FMU that were compiled for this machine.
#[derive(Debug)]
pub struct Compiled {
    /// One for each model identifier.
    pub libraries: Vec<CompiledLibrary>,
    /// What was left out of the build description.
    pub notes: Vec<String>,
    /// The commands, each with what the compiler printed.
    pub log: String,
}

/// A library that was compiled.
#[derive(Debug, Clone)]
pub struct CompiledLibrary {
    /// Its model identifier.
    pub identifier: String,
    /// Its path in the FMU, such as `binaries/linux64/Pid.so`.
    pub binary: String,
    /// The file, which is at this path in the folder.
    pub file: PathBuf,
}

/// Compiles the sources of an FMU, and writes the libraries to a folder.
///
/// # Errors
/// The FMU has no sources, or they cannot be compiled.
pub fn compile(
    fmu: &Path,
    folder: &Path,
    control: &CompileControl<'_>,
) -> Result<Compiled, CompileError> {
    let mut archive = Archive::open_sound(fmu)?;
    let text = archive.model_description()?;
    let root = xml::parse(&text).context(MODEL_DESCRIPTION)?;
    if let Some(other) = ModelDescription::other_version(&root) {
        return Err(CompileError::Description(other));
    }
    let version = FmiVersion::named(root.attribute("fmiVersion")).unwrap_or_default();
    let platform = platform(version)?;
    let Recipes { all, mut notes } = Recipes::read(&mut archive, &root, version)?;

    let mut workshop = Workshop::set_up(&mut archive, &all, control)
        .context("the sources cannot be unpacked to a temporary folder")?;
    let mut libraries = Vec::new();
    for recipe in &all {
        let binary = platform.binary(&recipe.identifier);
        let file = folder.join(&binary);
        fs::create_dir_all(file.parent().unwrap_or(folder)).context("cannot write the library")?;
        let objects = workshop.compile(recipe)?;
        workshop.link(recipe, &objects, &binary, &file)?;
        workshop::check_functions(&file, &binary, recipe, version)?;
        libraries.push(CompiledLibrary { identifier: recipe.identifier.clone(), binary, file });
    }
    notes.append(&mut workshop.notes);
    notes.dedup();
    Ok(Compiled { libraries, notes, log: workshop.log })
}

/// The binaries that an FMU would get by [`compile`] and has already.
///
/// # Errors
/// The FMU cannot be read.
pub fn binaries(fmu: &Path) -> Result<Vec<String>, CompileError> {
    let mut archive = Archive::open_sound(fmu)?;
    let text = archive.model_description()?;
    let root = xml::parse(&text).context(MODEL_DESCRIPTION)?;
    let version = FmiVersion::named(root.attribute("fmiVersion")).unwrap_or_default();
    let platform = platform(version)?;
    let identifiers = root.children.iter().filter_map(|e| e.attribute("modelIdentifier"));
    let mut binaries = Vec::from_iter(identifiers.map(|identifier| platform.binary(identifier)));
    binaries.sort_unstable();
    binaries.dedup();
    binaries.retain(|binary| archive.names.contains(binary));
    Ok(binaries)
}

/// Writes an FMU with the compiled libraries in place of its own for this machine; all other files remain as they are.
/// Returns its size in bytes.
///
/// # Errors
/// A file cannot be read or written.
pub fn write_with(fmu: &Path, libraries: &[CompiledLibrary], out: &Path) -> Result<u64> {
    let mut archive = Archive::open_sound(fmu)?;
    let mut files = Vec::new();
    let names = archive.names.clone();
    // The libraries follow the model description, before what is much larger.
    let mut added = Vec::new();
    for library in libraries {
        let content = fs::read(&library.file).context("cannot read the compiled library")?;
        added.push((library.binary.clone(), Packed::program(&content)?));
    }
    let first = names.iter().position(|name| name == MODEL_DESCRIPTION).map_or(0, |at| at + 1);
    for (index, name) in names.into_iter().enumerate() {
        let is_replaced = libraries.iter().any(|library| library.binary == name);
        if index == first {
            files.append(&mut added);
        }
        // An entry for the FMU itself has no name.
        if !is_replaced && !name.is_empty() {
            files.push((name, archive.packed(index)?));
        }
    }
    files.append(&mut added);
    // Windows does not replace open files.
    drop(archive);
    let entries = Vec::from_iter(files.iter().map(|(name, file)| (name, file)));
    archive::write(out, &entries)
}
