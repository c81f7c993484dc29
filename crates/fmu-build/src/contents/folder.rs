//! Reads folders of a package.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};

use super::File;

/// All files below a folder except hidden ones, sorted by their names; none if there is no such folder.
///
/// # Errors
/// A file cannot be read, or is not a file.
pub fn read(folder: &Path) -> Result<Vec<File>> {
    let mut files = Vec::new();
    if fs::symlink_metadata(folder).is_ok() {
        add(folder, "", &mut files)?;
        files.sort();
    }
    Ok(files)
}

/// Adds all files below a folder; `prefix` is added to their names.
fn add(folder: &Path, prefix: &str, files: &mut Vec<File>) -> Result<()> {
    let cannot = || format!("cannot read {}", folder.display());
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let entry = entry.with_context(cannot)?;
        let path = entry.path();
        let Ok(name) = entry.file_name().into_string() else {
            bail!("the file name {} is not UTF-8", path.display());
        };
        if name.starts_with('.') {
            continue;
        }
        let kind = entry.file_type().with_context(cannot)?;
        if kind.is_dir() {
            add(&path, &format!("{prefix}{name}/"), files)?;
        } else if kind.is_file() {
            let content =
                fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
            files.push((format!("{prefix}{name}"), content));
        } else {
            // A link could include any file of this machine in the FMU.
            bail!(
                "{} is a symbolic link or a device, expected a file",
                path.display()
            );
        }
    }
    Ok(())
}
