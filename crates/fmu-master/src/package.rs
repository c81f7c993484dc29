//! Packages (.ssp) and system structures (.ssd) that a system comes from, and the files that they refer to.

use std::path::{Path, PathBuf};

use anyhow::{Error, Result, bail, ensure};
use fmu_file::archive::{self, Archive};
use fmu_host::ProcessOwned;
use tempfile::TempDir;

use crate::note::Advice;

/// The system structure of a package.
pub(crate) const STRUCTURE_FILE: &str = "SystemStructure.ssd";

/// Where a system comes from if not from a TOML file.
#[derive(Debug, Default)]
pub struct SystemOrigin {
    /// What was left out, such as parameters without a variable.
    pub warnings: Vec<String>,
    /// The files outside of packages that it refers to.
    pub(crate) files: Vec<PathBuf>,
    /// The packages and structures, until the FMUs are loaded.
    pub(crate) opened: Vec<StructureFile>,
}

impl SystemOrigin {
    /// An error with the names of packages in place of the folders to which they are unpacked.
    pub(crate) fn with_package_names(&self, error: &Error) -> Error {
        with_package_names(&self.opened, error)
    }
}

/// As [`SystemOrigin::with_package_names`].
pub(crate) fn with_package_names(opened: &[StructureFile], error: &Error) -> Error {
    let unpacked = opened.iter().rev().filter(|files| files.is_package());
    let text = unpacked.fold(format!("{error:#}"), |text, files| {
        let [folder, file] = [&files.folder, &files.file].map(|path| path.display().to_string());
        text.replace(&folder, &file)
    });
    match Advice::in_error(error) {
        Some(advice) => advice.clone().after(text),
        None => Error::msg(text),
    }
}

/// Whether a file is a package or a system structure, by its name.
pub(crate) fn is_package(file: &Path) -> bool {
    has_extension(file, "ssp") || has_extension(file, "ssd")
}

fn has_extension(file: &Path, expected: &str) -> bool {
    file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(expected))
}

/// The files that a system structure refers to.
#[derive(Debug)]
pub(crate) struct StructureFile {
    /// The package or the structure.
    file: PathBuf,
    folder: PathBuf,
    /// The folder of a package, which files must not leave.
    unpacked: Option<ProcessOwned<TempDir>>,
}

impl StructureFile {
    /// Opens a structure (.ssd) or unpacks a package.
    ///
    /// # Errors
    /// It is not a package.
    pub(crate) fn open(file: &Path) -> Result<Self> {
        if has_extension(file, "ssd") {
            let folder = file.parent().unwrap_or(Path::new("")).to_owned();
            return Ok(Self { file: file.to_owned(), folder, unpacked: None });
        }
        let unpacked = tempfile::Builder::new().prefix("ssp-").tempdir()?;
        Archive::open_sound(file)?.unpack("", unpacked.path())?;
        let folder = unpacked.path().to_owned();
        ensure!(
            folder.join(STRUCTURE_FILE).exists(),
            "it is not an SSP package: it has no {STRUCTURE_FILE} at its root"
        );
        Ok(Self { file: file.to_owned(), folder, unpacked: Some(ProcessOwned::new(unpacked)) })
    }

    /// Whether its files are in a package.
    pub(crate) fn is_package(&self) -> bool {
        self.unpacked.is_some()
    }

    /// The text of the structure.
    ///
    /// # Errors
    /// It cannot be read.
    pub(crate) fn structure(&self) -> Result<String> {
        match self.is_package() {
            true => archive::read_ssp(&self.folder.join(STRUCTURE_FILE)),
            false => archive::read_ssp(&self.file),
        }
    }

    /// The file at a URI.
    ///
    /// # Errors
    /// It is not a relative path, or leaves the package.
    pub(crate) fn path(&self, uri: &str) -> Result<PathBuf> {
        let is_relative =
            !uri.is_empty() && !uri.starts_with('/') && !uri.contains([':', '#', '?']);
        let Some(path) = decoded(uri).filter(|_| is_relative) else {
            bail!("the source {uri:?} is not supported, expected the relative path of a file");
        };
        if self.is_package() {
            archive::relative(&path).map_err(Error::msg)?;
        }
        Ok(self.folder.join(path))
    }
}

/// A URI without percent encoding.
fn decoded(uri: &str) -> Option<String> {
    let mut parts = uri.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    for part in parts {
        bytes.push(u8::from_str_radix(part.get(..2)?, 16).ok()?);
        bytes.extend(part[2..].bytes());
    }
    String::from_utf8(bytes).ok()
}
