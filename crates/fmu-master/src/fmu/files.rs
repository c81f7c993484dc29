//! The files of an FMU: an archive, or a folder to which it was unpacked, as in a container.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION, read_ssp};
use fmu_host::ProcessOwned;
use tempfile::TempDir;

/// The files of an FMU.
pub(crate) enum FmuFiles {
    Archive(Archive),
    Folder(PathBuf),
}

impl FmuFiles {
    /// Opens an archive or a folder.
    ///
    /// # Errors
    /// The archive must not be unpacked.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        match path.is_dir() {
            true => Ok(Self::Folder(path.to_owned())),
            false => Ok(Self::Archive(Archive::open_sound(path)?)),
        }
    }

    /// The text of the model description.
    ///
    /// # Errors
    /// It cannot be read.
    pub(crate) fn model_description(&mut self) -> Result<String> {
        match self {
            Self::Archive(archive) => archive.model_description(),
            Self::Folder(folder) => read_ssp(&folder.join(MODEL_DESCRIPTION)),
        }
    }

    /// The names of all files of an archive, or of the binaries in a folder.
    pub(crate) fn names(&self) -> Vec<String> {
        let folder = match self {
            Self::Archive(archive) => return archive.names.clone(),
            Self::Folder(folder) => folder.join("binaries"),
        };
        let entries = |folder: &Path| fs::read_dir(folder).into_iter().flatten().flatten();
        let name = |entry: &fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        let of_platform = |platform: fs::DirEntry| {
            let binaries = entries(&platform.path());
            binaries.map(move |binary| format!("binaries/{}/{}", name(&platform), name(&binary)))
        };
        entries(&folder).flat_map(of_platform).collect()
    }

    /// The folder with all files, to which an archive is unpacked.
    ///
    /// # Errors
    /// The archive cannot be unpacked.
    pub(crate) fn unpack(self) -> Result<FmuFolder> {
        let mut archive = match self {
            Self::Archive(archive) => archive,
            Self::Folder(folder) => return Ok(FmuFolder::Unpacked(folder)),
        };
        let folder = tempfile::Builder::new().prefix("fmu-").tempdir()?;
        archive.unpack("", folder.path()).with_context(|| {
            format!("it cannot be unpacked to the folder {}", folder.path().display())
        })?;
        Ok(FmuFolder::Temporary(ProcessOwned::new(folder)))
    }
}

/// The folder with the files of an FMU.
pub(crate) enum FmuFolder {
    /// A folder of the master.
    Temporary(ProcessOwned<TempDir>),
    /// A folder of somebody else.
    Unpacked(PathBuf),
}

impl FmuFolder {
    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Temporary(folder) => folder.path(),
            Self::Unpacked(folder) => folder,
        }
    }
}
