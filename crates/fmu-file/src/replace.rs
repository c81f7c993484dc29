//! Atomic writing of files: completely or not at all.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File, Permissions, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result, bail, ensure};
use tempfile::{Builder, NamedTempFile};

/// A temporary file that replaces the target file when it is finished, with its permissions. If dropped before,
/// it leaves nothing behind.
pub struct Replacement {
    path: PathBuf,
    target: Destination,
}

enum Destination {
    /// A temporary file that is listed while it exists.
    Temporary(NamedTempFile, UnfinishedFile),
    /// A device, a pipe or a file without a path, which cannot be replaced.
    Device(File),
}

impl Replacement {
    /// Starts a replacement of `path`, in a hidden file beside it. If it is a link, the linked file is
    /// replaced, not the link.
    ///
    /// # Errors
    /// The folder does not exist or cannot be written to.
    pub fn new(path: &Path) -> Result<Self> {
        let target = linked(path);
        let mut prefix = OsString::from(".");
        prefix.push(target.file_name().unwrap_or_default());
        prefix.push(".");
        Self::create(path, &target, Builder::new().prefix(&prefix).suffix(".tmp"))
    }

    /// Like [`Replacement::new`], but the temporary file has the name of [`part_file`], so that its contents
    /// can be kept. An older file of that name is replaced.
    ///
    /// # Errors
    /// See [`Replacement::new`]; or another process writes the file.
    pub fn partial(path: &Path) -> Result<Self> {
        let target = linked(path);
        let Some(part) = part_file(path) else {
            return Self::create(path, &target, &mut Builder::new());
        };
        if let Ok(older) = File::open(&part) {
            if let Err(TryLockError::WouldBlock) = older.try_lock() {
                bail!("{} is in use by another process", part.display());
            }
            fs::remove_file(&part).with_context(|| format!("cannot remove {}", part.display()))?;
        }
        let name = part.file_name().unwrap_or_default();
        let new = Self::create(path, &target, Builder::new().prefix(name).rand_bytes(0))?;
        // File systems without locks cannot protect the file.
        let _ = new.file().try_lock();
        Ok(new)
    }

    fn create(path: &Path, target: &Path, builder: &mut Builder<'_, '_>) -> Result<Self> {
        check_is_file(path)?;
        let cannot = || format!("cannot write {}", path.display());
        let target = if is_device(target) {
            let file = File::options().write(true).open(target);
            Destination::Device(file.with_context(cannot)?)
        } else {
            let folder = match target.parent() {
                Some(folder) if !folder.as_os_str().is_empty() => folder,
                _ => Path::new("."),
            };
            ensure!(
                folder.is_dir(),
                "{}: the folder {} does not exist",
                cannot(),
                folder.display()
            );
            let older = fs::metadata(target).ok().filter(fs::Metadata::is_file);
            let permissions = older.map(|older| older.permissions());
            let (file, listed) = temporary(builder, folder, permissions).with_context(cannot)?;
            Destination::Temporary(file, listed)
        };
        let path = path.to_owned();
        Ok(Self { path, target })
    }

    fn file(&self) -> &File {
        match &self.target {
            Destination::Temporary(file, _) => file.as_file(),
            Destination::Device(file) => file,
        }
    }

    /// The number of bytes written; 0 for a device.
    ///
    /// # Errors
    /// The file system does not tell it.
    pub fn length(&self) -> io::Result<u64> {
        match &self.target {
            Destination::Temporary(file, _) => file.as_file().stream_position(),
            Destination::Device(_) => Ok(0),
        }
    }

    /// Replaces the target file.
    ///
    /// # Errors
    /// The disk is full, or the target is a folder.
    pub fn finish(self) -> Result<()> {
        if let Destination::Temporary(file, _listed) = self.target {
            let cannot = || format!("cannot write {}", self.path.display());
            file.as_file().sync_all().with_context(cannot)?;
            file.persist(linked(&self.path)).map_err(|error| error.error).with_context(cannot)?;
        }
        Ok(())
    }

    /// Keeps the temporary file and leaves the target as it is. Returns the temporary file, unless the
    /// target is a device.
    ///
    /// # Errors
    /// The disk is full; the file is kept all the same.
    pub fn keep(self) -> Result<Option<PathBuf>> {
        let Destination::Temporary(file, _listed) = self.target else { return Ok(None) };
        let (file, _) = file.keep()?;
        file.sync_all().with_context(|| format!("cannot write {}", self.path.display()))?;
        Ok(part_file(&self.path))
    }

    /// Drops everything after this number of bytes; nothing for a device.
    ///
    /// # Errors
    /// The file system cannot do it.
    pub fn truncate(&mut self, length: u64) -> io::Result<()> {
        match &mut self.target {
            Destination::Temporary(file, _) => {
                file.as_file().set_len(length)?;
                file.seek(SeekFrom::Start(length)).map(drop)
            }
            Destination::Device(_) => Ok(()),
        }
    }
}

impl Write for Replacement {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file().flush()
    }
}

/// Checks that a path to write to is not `-`.
///
/// # Errors
/// It is, and stands for the standard output.
pub fn check_is_file(path: &Path) -> Result<()> {
    ensure!(
        path != Path::new("-"),
        "- is the standard output, to which only rows in CSV are written; expected a file, such as ./-"
    );
    Ok(())
}

/// The name of a folder on a command line, where `-` is no name but the standard output.
///
/// # Errors
/// It is none.
pub fn folder(name: &str) -> Result<PathBuf, &'static str> {
    let is_name = !matches!(name, "" | "-");
    is_name.then(|| name.into()).ok_or("expected the name of a folder")
}

/// Writes a file atomically.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, content: &[u8]) -> Result<()> {
    let mut new = Replacement::new(path)?;
    new.write_all(content).with_context(|| format!("cannot write {}", path.display()))?;
    new.finish()
}

/// Checks that files can be written to a folder.
///
/// # Errors
/// The folder is not writable.
pub fn check_writable(folder: &Path) -> Result<()> {
    temporary(Builder::new().prefix(".fmu-"), folder, None)
        .map(drop)
        .with_context(|| format!("cannot write to the folder {}", folder.display()))
}

/// The file beside `path` for contents that are not complete: its name with the suffix `.part`. `None`
/// for a device, which is written directly.
pub fn part_file(path: &Path) -> Option<PathBuf> {
    let target = linked(path);
    if is_device(&target) {
        return None;
    }
    let mut name = target.into_os_string();
    name.push(".part");
    Some(name.into())
}

/// Removes the temporary files of all replacements that are in progress, before the process is ended
/// by a signal.
pub fn remove_unfinished() {
    for file in std::mem::take(&mut *unfinished()) {
        // Nobody can do anything about a file that cannot be removed.
        let _ = fs::remove_file(file);
    }
}

/// The temporary files of all replacements in progress.
fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    static FILES: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
    FILES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The file that a link leads to, or the path itself.
fn linked(path: &Path) -> PathBuf {
    let is_link = fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_symlink());
    let target = is_link.then(|| fs::canonicalize(path).ok()).flatten();
    target.unwrap_or_else(|| path.to_owned())
}

/// Whether it can only be written directly. As `/dev/stdout`, a link can lead to a file that was removed.
fn is_device(path: &Path) -> bool {
    let has_path =
        |data: &fs::Metadata| data.is_dir() || data.is_file() && path.canonicalize().is_ok();
    fs::metadata(path).is_ok_and(|data| !has_path(&data))
}

/// A file in the list of unfinished ones.
struct UnfinishedFile(PathBuf);

impl Drop for UnfinishedFile {
    fn drop(&mut self) {
        unfinished().remove(&self.0);
    }
}

/// Creates a temporary file in a folder, on Unix with these permissions, or the permissions of an ordinary new file.
fn temporary(
    builder: &mut Builder<'_, '_>,
    folder: &Path,
    permissions: Option<Permissions>,
) -> io::Result<(NamedTempFile, UnfinishedFile)> {
    #[cfg(unix)]
    builder.permissions(
        permissions.clone().unwrap_or(std::os::unix::fs::PermissionsExt::from_mode(0o666)),
    );
    let file = builder.tempfile_in(folder)?;
    if let Some(permissions) = permissions.filter(|_| cfg!(unix)) {
        // Also those that the process does not give to new files. Some file systems have none.
        let _ = file.as_file().set_permissions(permissions);
    }
    let path = file.path().to_owned();
    unfinished().insert(path.clone());
    Ok((file, UnfinishedFile(path)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The names of the files in a folder, sorted.
    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let name = |entry: io::Result<fs::DirEntry>| entry.unwrap().file_name();
        let mut names: Vec<String> = entries.map(|e| name(e).into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn the_old_file_remains_until_the_new_one_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pid.csv");
        fs::write(&path, "old").unwrap();
        let mut new = Replacement::new(&path).unwrap();
        new.write_all(b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        let hidden = names(folder.path()).remove(0);
        assert!(hidden.starts_with(".pid.csv.") && hidden.ends_with(".tmp"), "{hidden}");
        new.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        drop(Replacement::new(&path).unwrap());
        assert_eq!(names(folder.path()), ["pid.csv"]);
    }

    #[test]
    fn a_part_can_be_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pid.csv");
        let kept = Replacement::partial(&path).unwrap().keep().unwrap();
        assert_eq!(kept, part_file(&path));
        assert_eq!(names(folder.path()), ["pid.csv.part"]);
        Replacement::partial(&path).unwrap().finish().unwrap();
        assert_eq!(names(folder.path()), ["pid.csv"]);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_permissions_kept_and_devices_written_directly() {
        use std::os::unix::fs::PermissionsExt;

        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a"), folder.path().join("link"));
        fs::write(&path, "old").unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o622)).unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        write(&link, b"new").unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o622);
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&path).unwrap(), b"new");
        write(Path::new("/dev/null"), b"gone").unwrap();
        if cfg!(target_os = "linux") {
            let [removed, stdout] = ["removed", "stdout"].map(|name| folder.path().join(name));
            let file = File::create(&removed).unwrap();
            let opened = format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&file));
            std::os::unix::fs::symlink(opened, &stdout).unwrap();
            fs::remove_file(&removed).unwrap();
            write(&stdout, b"rows").unwrap();
            assert_eq!(file.metadata().unwrap().len(), 4);
            assert!(stdout.is_symlink());
        }
    }

    #[test]
    fn a_folder_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("a");
        fs::create_dir(&taken).unwrap();
        assert!(write(&taken, b"new").is_err());
        assert_eq!(names(folder.path()), ["a"]);
        let missing = write(Path::new("missing/folder/a"), b"").unwrap_err();
        assert_eq!(
            missing.to_string(),
            "cannot write missing/folder/a: the folder missing/folder does not exist"
        );
    }
}
