//! The FMUs in a package.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use fmu_file::archive::{Entry, Packed};

/// The FMUs of a package by their names in it, each stored once.
#[derive(Default)]
pub struct Resources {
    files: BTreeMap<String, File>,
}

struct File {
    path: PathBuf,
    content: Vec<u8>,
    packed: Packed,
}

impl Resources {
    /// Adds an FMU unless it is already there; returns its path in the package.
    ///
    /// # Errors
    /// The FMU cannot be read, or a different FMU has the same name.
    pub fn add(&mut self, fmu: &Path) -> Result<String> {
        let name = name(fmu);
        // Some file systems do not distinguish "a" from "A".
        let key = name.to_ascii_lowercase();
        let place = format!("resources/{name}");
        if self.files.get(&key).is_some_and(|known| known.path == fmu) {
            return Ok(place);
        }
        let content = fs::read(fmu).with_context(|| format!("cannot read {}", fmu.display()))?;
        if let Some(known) = self.files.get(&key) {
            ensure!(
                known.content == content && self::name(&known.path) == name,
                "{} and {} are different FMUs that would have the same name in the package; rename one",
                known.path.display(),
                fmu.display()
            );
            return Ok(place);
        }
        let path = fmu.to_owned();
        let packed = Packed::stored(&content)?;
        let file = File {
            path,
            content,
            packed,
        };
        self.files.insert(key, file);
        Ok(place)
    }

    /// The entries of the archive.
    pub fn entries(&self) -> impl Iterator<Item = Entry<'_>> {
        self.files
            .values()
            .map(|file| Entry::new(format!("resources/{}", name(&file.path)), &file.packed))
    }
}

/// The file name without characters that are not allowed in a URI.
fn name(fmu: &Path) -> String {
    let name = fmu.file_name().unwrap_or_default().to_string_lossy();
    name.replace(
        |c: char| !(c.is_ascii_alphanumeric() || "._-".contains(c)),
        "_",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes files `folder/name` with some content and adds them to a package.
    fn add(files: &[(&str, &str)]) -> Result<Vec<String>> {
        let folder = tempfile::tempdir().unwrap();
        let mut resources = Resources::default();
        for (file, content) in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        let places = files
            .iter()
            .map(|(file, _)| resources.add(&folder.path().join(file)))
            .collect::<Result<Vec<_>>>()?;
        let mut distinct = places.clone();
        distinct.sort();
        distinct.dedup();
        assert_eq!(resources.entries().count(), distinct.len());
        Ok(places)
    }

    #[test]
    fn an_fmu_is_stored_once() {
        let places = add(&[
            ("A.fmu", "a"),
            ("A.fmu", "a"),
            ("copy/A.fmu", "a"),
            ("B.fmu", "a"),
        ]);
        let expected = ["A.fmu", "A.fmu", "A.fmu", "B.fmu"].map(|name| format!("resources/{name}"));
        assert_eq!(places.unwrap(), expected);
    }

    #[test]
    fn different_fmus_with_the_same_name_are_rejected() {
        for other in ["other/A.fmu", "other/a.fmu"] {
            let error = add(&[("A.fmu", "a"), (other, "b")]).unwrap_err();
            let error = error.to_string();
            assert!(
                error.contains("A.fmu and ") && error.contains(other),
                "{error}"
            );
        }
        assert!(add(&[("A B.fmu", "a"), ("A_B.fmu", "b")]).is_err());
    }

    #[test]
    fn a_path_is_a_uri() {
        let places = add(&[("Cart & pole #1.fmu", "a")]).unwrap();
        assert_eq!(places, ["resources/Cart___pole__1.fmu"]);
    }
}
