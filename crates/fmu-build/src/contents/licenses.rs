//! The licence files of a package.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use cargo_metadata::Metadata;

use super::File;
use crate::library::Library;

/// The licence files of a package, else those in the root of its workspace, with their paths in the
/// documentation.
pub fn read(library: &Library, metadata: &Metadata) -> Result<Vec<File>> {
    let mut found = in_folder(&library.folder)?;
    if let Some(file) = &library.license_file {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let content = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        found.retain(|(path, _)| !path.ends_with(&*name));
        found.push((format!("licenses/{name}"), content));
    }
    if found.is_empty() {
        found = in_folder(metadata.workspace_root.as_std_path())?;
    }
    found.sort();
    Ok(found)
}

fn in_folder(folder: &Path) -> Result<Vec<File>> {
    let mut found = Vec::new();
    let cannot = || format!("cannot read {}", folder.display());
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let path = entry.with_context(cannot)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_license = ["LICENSE", "LICENCE", "COPYING", "NOTICE"]
            .iter()
            .any(|start| name.to_uppercase().starts_with(start));
        if is_license && path.is_file() {
            let content = fs::read(&path).with_context(cannot)?;
            found.push((format!("licenses/{name}"), content));
        }
    }
    Ok(found)
}
