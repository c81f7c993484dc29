//! The files of an FMU other than the model description and the binaries: an HTML page generated from
//! the model description and the package's folder `documentation/<MODEL>/`, an icon, the licences, the
//! package's folder `resources/`, and its folder `references/<MODEL>/`.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use cargo_metadata::Metadata;
use fmu_description::{FmiVersion, ModelDescription, xml};
use fmu_file::archive::{BUS_MANIFEST, DOCUMENTATION, ICON, ICON_3, TERMINALS};

use crate::library::{ModelLibrary, NamedFile, read};
use crate::model::BuiltModel;
use crate::page;
use crate::references;

/// An HTML fragment in the folder of a model, the middle of the page. `<!-- include FILE -->` is replaced by
/// a file of the same folder.
const ABOUT: &str = "about.html";
const INCLUDE: &str = "<!-- include ";
const INCLUDE_END: &str = " -->";
/// The model's icon in the same folder.
const OWN_ICON: &str = "icon.png";
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Names that the export itself uses.
const RESERVED: [&str; 3] = ["index.html", "licenses", "staticlinking.txt"];

/// All files of a model.
///
/// # Errors
/// A file of the model cannot be used.
pub fn files(model: &BuiltModel<'_>, metadata: &Metadata) -> Result<Vec<NamedFile>> {
    let folder = &model.library.folder;
    let is_fmi_3 = model.version == FmiVersion::Fmi3;
    let documentation = Documentation::read(&folder.join("documentation").join(&model.base))
        .with_context(|| format!("the documentation of {} cannot be used", model.base))?;
    let mut licenses = licenses(model.library, metadata)?;
    if is_fmi_3 {
        add_entry_point(&mut licenses, model.library.origin.license.as_deref());
    }
    let root = xml::parse(&model.xml)?;
    let icon_path = if is_fmi_3 { ICON_3 } else { ICON };
    let icon = documentation.icon.map(|icon| (icon_path.to_owned(), icon));
    let page = page::html(
        &ModelDescription::new(&root),
        &model.file_name(),
        documentation.about.as_deref(),
        icon.as_ref().map(|_| icon_path),
        &licenses,
        model.sources.as_ref(),
    );
    let below = |folder: &'static str| {
        move |(name, content): NamedFile| (format!("{folder}/{name}"), content)
    };
    let mut files = vec![(DOCUMENTATION.to_owned(), page.into_bytes())];
    files.extend(documentation.others.into_iter().map(below("documentation")));
    files.extend(licenses.into_iter().map(below("documentation")));
    if is_fmi_3 && let Some(xml) = model.description.terminals(icon.is_some())? {
        files.push((TERMINALS.to_owned(), xml.document()?.into_bytes()));
    }
    if is_fmi_3 && let Some(xml) = model.description.bus_manifest() {
        files.push((BUS_MANIFEST.to_owned(), xml.document()?.into_bytes()));
    }
    files.extend(icon);
    let resources = read(&folder.join("resources")).context("the resources cannot be used")?;
    files.extend(resources.into_iter().map(below("resources")));
    files.extend(references::files(folder, &model.base)?);
    files.extend(model.sources.iter().flat_map(|sources| sources.files.clone()));
    Ok(files)
}

/// The documentation files of a model; empty if there is no folder.
#[derive(Default)]
struct Documentation {
    /// The middle of the page.
    about: Option<String>,
    icon: Option<Vec<u8>>,
    /// All other files with their paths in the folder.
    others: Vec<NamedFile>,
}

impl Documentation {
    fn read(path: &Path) -> Result<Self> {
        let mut documentation = Self { others: read(path)?, ..Self::default() };
        for (name, _) in &documentation.others {
            let first = name.split('/').next().unwrap_or_default();
            ensure!(
                !RESERVED.contains(&first.to_lowercase().as_str()),
                "{} has a name that is reserved for the export, expected another name",
                path.join(first).display()
            );
        }
        let about = documentation.take(ABOUT);
        documentation.icon = documentation.take(OWN_ICON);
        documentation.about = about
            .map(|about| text(ABOUT, about).and_then(|about| documentation.include(&about)))
            .transpose()
            .with_context(|| path.display().to_string())?;
        if let Some(icon) = &documentation.icon {
            ensure!(icon.starts_with(PNG), "{} is not a PNG image", path.join(OWN_ICON).display());
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

/// The licence files of a package, else those in the root of its workspace, with their paths in the
/// documentation.
fn licenses(library: &ModelLibrary, metadata: &Metadata) -> Result<Vec<NamedFile>> {
    let mut found = licenses_in(&library.folder)?;
    if let Some(file) = &library.license_file {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let content = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        found.retain(|(path, _)| !path.ends_with(&*name));
        found.push((format!("licenses/{name}"), content));
    }
    if found.is_empty() {
        found = licenses_in(metadata.workspace_root.as_std_path())?;
    }
    found.sort();
    Ok(found)
}

fn licenses_in(folder: &Path) -> Result<Vec<NamedFile>> {
    let mut found = Vec::new();
    let cannot = || format!("cannot read {}", folder.display());
    for entry in fs::read_dir(folder).with_context(cannot)? {
        let path = entry.with_context(cannot)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let starts = ["LICENSE", "LICENCE", "COPYING", "NOTICE"];
        let is_license = |start: &&str| name.to_uppercase().starts_with(start);
        if starts.iter().any(is_license) && path.is_file() {
            let content = fs::read(&path).with_context(cannot)?;
            found.push((format!("licenses/{name}"), content));
        }
    }
    Ok(found)
}

/// Adds the file that FMI 3.0 demands as the first to be read (section 2.5.1.1.1), unless there are no
/// licence files or one of them has its name; `license` is the SPDX expression.
fn add_entry_point(found: &mut Vec<NamedFile>, license: Option<&str>) {
    const NAMES: [&str; 3] = ["license.txt", "license.html", "license.spdx"];
    let names = found.iter().filter_map(|(path, _)| path.rsplit('/').next());
    let names: Vec<_> = names.map(str::to_owned).collect();
    let lower: Vec<_> = names.iter().map(|name| name.to_lowercase()).collect();
    if let Some(index) = lower.iter().position(|name| NAMES.contains(&name.as_str())) {
        found[index].0 = format!("licenses/{}", lower[index]);
    } else if !names.is_empty() {
        let license = license.map_or(String::new(), |license| format!("Licence: {license}\n"));
        let text = format!("{license}Texts: {}\n", names.join(", "));
        found.push((format!("licenses/{}", NAMES[0]), text.into_bytes()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn documentation(files: &[(&str, &[u8])]) -> Result<Documentation> {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        Documentation::read(folder.path())
    }

    #[test]
    fn files_are_sorted_by_role_and_included_in_the_page() {
        let about = b"1 <!-- include d.svg --> 2 <!-- a comment -->";
        let read = documentation(&[
            ("b.svg", b"b"),
            ("a/c.svg", b"c"),
            ("d.svg", b"D\n"),
            (".hidden", b""),
            ("icon.png", PNG),
            ("about.html", about),
        ]);
        let read = read.unwrap();
        assert_eq!(read.about.as_deref(), Some("1 D 2 <!-- a comment -->"));
        assert_eq!(read.icon.as_deref(), Some(PNG));
        let others = [("a/c.svg", b"c"), ("b.svg", b"b")];
        assert_eq!(read.others, others.map(|(name, content)| (name.to_owned(), content.to_vec())));
        let none = Documentation::read(Path::new("nowhere")).unwrap();
        assert!(none.about.is_none() && none.icon.is_none() && none.others.is_empty());
    }

    #[test]
    fn errors_name_the_file() {
        for (name, content, expected) in [
            ("about.html", &b"ab\xff"[..], "about.html is not UTF-8 from byte 2 on"),
            ("about.html", b"<!-- include a.svg -->", "\"a.svg\" is included"),
            ("about.html", b"<!-- include ../a -->", "\"../a\" is included"),
            ("about.html", b"<!-- include a", "without \" -->\""),
            ("icon.png", b"GIF89a", "icon.png is not a PNG"),
            ("Index.html", b"", "Index.html has a name"),
            ("licenses/a", b"", "licenses has a name"),
        ] {
            let error = format!("{:#}", documentation(&[(name, content)]).err().unwrap());
            assert!(error.contains(expected), "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn symbolic_links_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink("/etc/passwd", folder.path().join("a.svg")).unwrap();
        let error = read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("a.svg is a symbolic link"), "{error}");
    }

    #[test]
    fn licences_have_an_entry_point() {
        let text = "Licence: MIT OR Apache-2.0\nTexts: LICENSE-APACHE, LICENSE-MIT\n";
        for (names, expected, content) in [
            ("LICENSE-APACHE LICENSE-MIT", "LICENSE-APACHE LICENSE-MIT license.txt", text),
            ("NOTICE LICENSE.TXT", "NOTICE license.txt", "text"),
            ("", "", ""),
        ] {
            let path = |name: &str| format!("licenses/{name}");
            let names = names.split_whitespace();
            let mut found = names.map(|name| (path(name), b"text".to_vec())).collect();
            add_entry_point(&mut found, Some("MIT OR Apache-2.0"));
            let expected = expected.split_whitespace().map(path);
            assert!(found.iter().map(|(path, _)| path.clone()).eq(expected));
            let last = found.last().map_or("", |(_, text)| str::from_utf8(text).unwrap());
            assert_eq!(last, content);
        }
    }
}
