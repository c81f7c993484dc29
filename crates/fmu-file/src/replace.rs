//! Atomic writing of files: completely or not at all.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use tempfile::{Builder, NamedTempFile};

/// A temporary file that replaces the target file when it is finished. If dropped before, it leaves
/// nothing behind.
pub struct Replacement {
    path: PathBuf,
    target: Target,
}

enum Target {
    Temporary(NamedTempFile),
    /// A device or a pipe, which cannot be replaced.
    Device(File),
}

impl Replacement {
    /// Starts a replacement of `path`. If it is a link, the linked file is replaced, not the link.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn of(path: &Path) -> Result<Self> {
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let is_device = fs::metadata(&path).is_ok_and(|m| !m.is_file() && !m.is_dir());
        let target = if is_device {
            let file = File::options().write(true).open(&path);
            Target::Device(file.with_context(|| format!("cannot write {}", path.display()))?)
        } else {
            Target::Temporary(temporary(folder(&path))?)
        };
        Ok(Self { path, target })
    }

    /// Replaces the target file.
    ///
    /// # Errors
    /// The disk is full, or the target is a folder.
    pub fn finish(self) -> Result<()> {
        let Target::Temporary(file) = self.target else {
            return Ok(());
        };
        let cannot = || format!("cannot write {}", self.path.display());
        file.as_file().sync_all().with_context(cannot)?;
        file.persist(&self.path).with_context(cannot)?;
        Ok(())
    }
}

impl Write for Replacement {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.target {
            Target::Temporary(file) => file.write(bytes),
            Target::Device(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.target {
            Target::Temporary(file) => file.flush(),
            Target::Device(file) => file.flush(),
        }
    }
}

/// Writes a file atomically.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, content: &[u8]) -> Result<()> {
    let mut new = Replacement::of(path)?;
    new.write_all(content)
        .with_context(|| format!("cannot write {}", path.display()))?;
    new.finish()
}

/// Checks that files can be written to a folder.
///
/// # Errors
/// The folder is not writable.
pub fn check_writable(folder: &Path) -> Result<()> {
    temporary(folder).map(drop)
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Creates a temporary file in a folder, with the permissions of an ordinary new file.
fn temporary(folder: &Path) -> Result<NamedTempFile> {
    let mut builder = Builder::new();
    builder.prefix(".fmu-");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder
        .tempfile_in(folder)
        .with_context(|| format!("cannot write to the folder {}", folder.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_old_file_remains_until_the_new_one_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "old").unwrap();
        let mut new = Replacement::of(&path).unwrap();
        new.write_all(b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        new.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        drop(Replacement::of(&path).unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_devices_are_written_directly() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a"), folder.path().join("link"));
        fs::write(&path, "old").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let mut new = Replacement::of(&link).unwrap();
        new.write_all(b"new").unwrap();
        new.finish().unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&path).unwrap(), b"new");

        let mut null = Replacement::of(Path::new("/dev/null")).unwrap();
        null.write_all(b"gone").unwrap();
        null.finish().unwrap();
    }

    #[test]
    fn a_folder_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("a");
        fs::create_dir(&taken).unwrap();
        assert!(Replacement::of(&taken).unwrap().finish().is_err());
        assert!(Replacement::of(Path::new("missing/folder/a")).is_err());
    }
}
