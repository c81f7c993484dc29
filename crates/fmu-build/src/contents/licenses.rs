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

/// Adds the file that FMI 3.0 demands as the first to be read (section 2.5.1.1.1), unless there are no
/// licence files or one of them has its name; `license` is the SPDX expression.
pub fn add_entry_point(found: &mut Vec<File>, license: Option<&str>) {
    const NAMES: [&str; 3] = ["license.txt", "license.html", "license.spdx"];
    let names: Vec<_> = found
        .iter()
        .filter_map(|(path, _)| path.rsplit('/').next())
        .collect();
    if names.is_empty() {
        return;
    }
    let lower: Vec<_> = names.iter().map(|name| name.to_lowercase()).collect();
    if let Some(index) = lower.iter().position(|name| NAMES.contains(&name.as_str())) {
        found[index].0 = format!("licenses/{}", lower[index]);
        return;
    }
    let license = license.map_or(String::new(), |license| format!("Licence: {license}\n"));
    let text = format!("{license}Texts: {}\n", names.join(", "));
    found.push((format!("licenses/{}", NAMES[0]), text.into_bytes()));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn with_entry_point(names: &[&str]) -> Vec<(String, String)> {
        let file = |name: &&str| (format!("licenses/{name}"), b"text".to_vec());
        let mut found = names.iter().map(file).collect();
        add_entry_point(&mut found, Some("MIT OR Apache-2.0"));
        found
            .into_iter()
            .map(|(path, content)| (path, String::from_utf8(content).unwrap()))
            .collect()
    }

    #[test]
    fn licences_have_an_entry_point() {
        let found = with_entry_point(&["LICENSE-APACHE", "LICENSE-MIT"]);
        assert_eq!(found.len(), 3);
        let text = "Licence: MIT OR Apache-2.0\nTexts: LICENSE-APACHE, LICENSE-MIT\n";
        assert_eq!(found[2], ("licenses/license.txt".into(), text.into()));
    }

    #[test]
    fn a_licence_with_the_name_of_the_entry_point_is_it() {
        let found = with_entry_point(&["LICENSE.TXT", "NOTICE"]);
        let expected = [
            ("licenses/license.txt", "text"),
            ("licenses/NOTICE", "text"),
        ];
        assert_eq!(
            found,
            expected.map(|(path, text)| (path.into(), text.into()))
        );
        assert!(with_entry_point(&[]).is_empty());
    }
}
