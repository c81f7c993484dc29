//! The documentation of a model in its package, `documentation/<MODEL>/`.

use std::path::Path;

use anyhow::{Context, Result, ensure};

use super::{File, folder};

/// An HTML fragment, the middle of the page. `<!-- include FILE -->` is replaced by a file of the same
/// folder.
const ABOUT: &str = "about.html";
/// The model's icon.
const ICON: &str = "icon.png";
/// Names that the export itself uses.
const RESERVED: [&str; 2] = ["index.html", "licenses"];

const INCLUDE: &str = "<!-- include ";
const INCLUDE_END: &str = " -->";
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// The documentation files of a model; empty if there is no folder.
#[derive(Default)]
pub struct Documentation {
    /// The middle of the page.
    pub about: Option<String>,
    /// The icon.
    pub icon: Option<Vec<u8>>,
    /// All other files with their paths in the folder.
    pub others: Vec<File>,
}

impl Documentation {
    /// Reads the folder, if it exists.
    ///
    /// # Errors
    /// A file in it cannot be used.
    pub fn read(path: &Path) -> Result<Self> {
        let mut documentation = Self {
            others: folder::read(path)?,
            ..Self::default()
        };
        for (name, _) in &documentation.others {
            let first = name.split('/').next().unwrap_or_default();
            ensure!(
                !RESERVED.contains(&first.to_lowercase().as_str()),
                "{} has a name that is reserved for the export, expected another name",
                path.join(first).display()
            );
        }
        let about = documentation.take(ABOUT);
        documentation.icon = documentation.take(ICON);
        documentation.about = about
            .map(|about| text(ABOUT, about).and_then(|about| documentation.include(&about)))
            .transpose()
            .with_context(|| path.display().to_string())?;
        if let Some(icon) = &documentation.icon {
            ensure!(
                icon.starts_with(PNG),
                "{} is not a PNG image",
                path.join(ICON).display()
            );
        }
        Ok(documentation)
    }

    fn take(&mut self, name: &str) -> Option<Vec<u8>> {
        let index = self.others.iter().position(|(other, _)| other == name)?;
        Some(self.others.remove(index).1)
    }

    /// Replaces include comments by the included files, which are then no longer separate files.
    fn include(&mut self, about: &str) -> Result<String> {
        let mut parts = about.split(INCLUDE);
        let mut whole = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let (name, rest) = part.split_once(INCLUDE_END).with_context(|| {
                format!("{ABOUT}: {INCLUDE:?} without {INCLUDE_END:?} after it")
            })?;
            let content = self.take(name).with_context(|| {
                format!("{ABOUT}: {name:?} is included, expected this file in the same folder, included once")
            })?;
            whole += text(name, content)?.trim_end();
            whole += rest;
        }
        Ok(whole)
    }
}

fn text(name: &str, content: Vec<u8>) -> Result<String> {
    String::from_utf8(content).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        anyhow::anyhow!("{name} is not UTF-8 from byte {at} on")
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn read(files: &[(&str, &[u8])]) -> Result<Documentation> {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        Documentation::read(folder.path())
    }

    fn error(files: &[(&str, &[u8])]) -> String {
        format!("{:#}", read(files).err().unwrap())
    }

    #[test]
    fn the_folder_is_optional() {
        let documentation = Documentation::read(Path::new("nowhere")).unwrap();
        assert!(
            documentation.about.is_none()
                && documentation.icon.is_none()
                && documentation.others.is_empty()
        );
    }

    #[test]
    fn files_are_sorted_by_role() {
        let documentation = read(&[
            ("b.svg", b"b"),
            ("a/c.svg", b"c"),
            (".hidden", b""),
            ("icon.png", PNG),
            ("about.html", b"<p>"),
        ])
        .unwrap();
        assert_eq!(documentation.about.as_deref(), Some("<p>"));
        assert_eq!(documentation.icon.as_deref(), Some(PNG));
        let expected = [("a/c.svg", b"c"), ("b.svg", b"b")];
        assert_eq!(
            documentation.others,
            expected.map(|(name, content)| (name.to_owned(), content.to_vec()))
        );
    }

    #[test]
    fn an_included_file_becomes_part_of_the_page() {
        let about = b"1 <!-- include a.svg --> 2 <!-- include b.svg --> 3 <!-- a comment -->";
        let documentation =
            read(&[("about.html", about), ("a.svg", b"A\n"), ("b.svg", b"B")]).unwrap();
        assert_eq!(
            documentation.about.as_deref(),
            Some("1 A 2 B 3 <!-- a comment -->")
        );
        assert!(documentation.others.is_empty());
    }

    #[test]
    fn errors_name_the_file() {
        let about = |text| error(&[("about.html", text)]);
        assert!(about(b"ab\xff").ends_with("about.html is not UTF-8 from byte 2 on"));
        assert!(about(b"<!-- include a.svg -->").contains("\"a.svg\""));
        assert!(about(b"<!-- include ../a -->").contains("\"../a\""));
        assert!(about(b"<!-- include a").contains("without \" -->\""));
        assert!(error(&[("icon.png", b"GIF89a")]).contains("icon.png is not a PNG"));
        assert!(error(&[("Index.html", b"")]).contains("Index.html has a name"));
        assert!(error(&[("licenses/a", b"")]).contains("licenses has a name"));
    }

    #[cfg(unix)]
    #[test]
    fn symbolic_links_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/etc/passwd", folder.path().join("a.svg")).unwrap();
        let error = Documentation::read(folder.path())
            .err()
            .unwrap()
            .to_string();
        assert!(error.contains("a.svg is a symbolic link"), "{error}");
    }
}
