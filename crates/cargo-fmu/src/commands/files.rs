//! The files that a command takes, of which a shell may have left patterns as they are: on Windows, none expands them.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

/// The files, with those that match in place of each pattern with `*`, `?` or `[`, in the order of their names. An
/// existing file is no pattern.
///
/// # Errors
/// No file matches a pattern, or a folder cannot be read.
pub(super) fn expanded(files: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut all = Vec::new();
    for file in files {
        let pattern = file.to_str().filter(|text| text.contains(['*', '?', '[']) && !file.exists());
        let Some(pattern) = pattern else {
            all.push(file.clone());
            continue;
        };
        let matching =
            glob::glob(pattern).with_context(|| format!("{pattern} is an invalid pattern"))?;
        let matching = matching.collect::<Result<Vec<_>, _>>()?;
        ensure!(!matching.is_empty(), "no file matches {pattern}");
        all.extend(matching);
    }
    Ok(all)
}

/// The name of a file without its folder and extension.
pub fn stem(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_becomes_its_files_unless_it_is_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["b.fmu", "a.fmu", "[c].fmu", "d.txt"] {
            std::fs::write(path(name), "").unwrap();
        }
        let given = [path("?.fmu"), path("[c].fmu"), path("none.fmu")];
        let expected = ["a.fmu", "b.fmu", "[c].fmu", "none.fmu"].map(path);
        assert_eq!(expanded(&given).unwrap(), expected);
        for (pattern, reason) in [("no/*.fmu", "no file matches "), ("[a", "is an invalid pattern")]
        {
            let error = expanded(&[path(pattern)]).unwrap_err().to_string();
            assert!(error.contains(reason) && error.contains(pattern), "{error}");
        }
    }
}
