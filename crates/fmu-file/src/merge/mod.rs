//! Merges FMUs of one model that were built on several machines into one FMU for all platforms.

mod difference;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};

use crate::archive::{self, Archive, Entry, ICON, MODEL_DESCRIPTION, Packed};
use crate::platform;
use crate::text::{about, quote};
use difference::{Difference, differences};
use fmu_description::xml::{self, Element};

/// Maximum number of differences shown.
const MAX_SHOWN: usize = 20;

/// The result of a merge.
#[derive(Debug)]
pub struct Merged {
    /// Size of the FMU in bytes.
    pub size: u64,
    /// The platform folders that it has binaries in.
    pub platforms: Vec<String>,
    /// Harmless differences, and which FMU was used.
    pub notes: Vec<String>,
}

/// An FMU to merge.
struct Fmu {
    path: PathBuf,
    archive: Archive,
    description: String,
}

/// The source of a file: the index of the FMU, and the index of the file in it.
type Source = (usize, usize);

/// The parts of an FMU, in the order in which `cargo fmu export` writes them.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    ModelDescription,
    Binaries,
    Rest,
}

/// Merges two or more FMUs and writes the result to `out`, which may be one of them.
///
/// # Errors
/// An FMU cannot be read or does not match the others, or `out` cannot be written.
pub fn merge(files: &[PathBuf], out: &Path) -> Result<Merged> {
    ensure!(
        files.len() > 1,
        "got {} FMU, expected two or more",
        files.len()
    );
    let mut notes = Vec::new();
    let mut fmus = files
        .iter()
        .map(|path| Fmu::open(path))
        .collect::<Result<Vec<_>>>()?;
    for other in &fmus[1..] {
        check_same_model(&fmus[0], other, &mut notes)?;
    }
    let files = sources(&fmus)
        .into_values()
        .map(|sources| choose(&sources, &mut fmus, &mut notes))
        .collect::<Result<Vec<_>>>()?;
    // Windows does not replace open files.
    drop(fmus);
    let entries: Vec<_> = files
        .iter()
        .map(|(name, file)| Entry::new(name.as_str(), file))
        .collect();
    let platforms = platform::folders(files.iter().map(|(name, _)| name));
    Ok(Merged {
        size: archive::write(out, &entries)?,
        platforms: platforms.into_iter().map(str::to_owned).collect(),
        notes,
    })
}

impl Fmu {
    fn open(path: &Path) -> Result<Self> {
        let read = || {
            let mut archive = Archive::open_sound(path)?;
            let description = archive.model_description()?;
            let root = root(&description)?;
            ensure!(
                root.name == "fmiModelDescription",
                "{MODEL_DESCRIPTION} has the root {}, expected fmiModelDescription",
                quote(root.name)
            );
            Ok((archive, description))
        };
        let (archive, description) = read().map_err(|error| about(path, &error))?;
        Ok(Self {
            path: path.to_owned(),
            archive,
            description,
        })
    }

    fn content(&mut self, file: usize) -> Result<Vec<u8>> {
        let content = self.archive.content(file);
        content.map_err(|error| about(&self.path, &error))
    }

    fn packed(&mut self, file: usize) -> Result<Packed> {
        let packed = self.archive.packed(file);
        packed.map_err(|error| about(&self.path, &error))
    }
}

fn root(description: &str) -> Result<Element<'_>> {
    xml::parse(description).with_context(|| format!("{MODEL_DESCRIPTION} cannot be read"))
}

/// Checks that two model descriptions agree, and notes harmless differences.
fn check_same_model(first: &Fmu, other: &Fmu, notes: &mut Vec<String>) -> Result<()> {
    let (left, right) = (root(&first.description)?, root(&other.description)?);
    let (harmless, conflicts): (Vec<_>, Vec<_>) = differences(&left, &right)
        .into_iter()
        .partition(|difference| difference.is_harmless);
    let shown = |difference: &Difference| {
        let [left, right] = difference.values.each_ref();
        let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".into());
        format!(
            "{}: {} in {}, {} in {}",
            difference.path,
            text(left),
            first.path.display(),
            text(right),
            other.path.display()
        )
    };
    if !conflicts.is_empty() {
        let mut lines: Vec<_> = conflicts.iter().take(MAX_SHOWN).map(shown).collect();
        if conflicts.len() > MAX_SHOWN {
            lines.push("and more".into());
        }
        bail!(
            "{} and {} are not the same version of the same model; {MODEL_DESCRIPTION} differs:\n  {}",
            first.path.display(),
            other.path.display(),
            lines.join("\n  ")
        );
    }
    notes.extend(
        harmless
            .iter()
            .map(|difference| note(&shown(difference), first)),
    );
    Ok(())
}

/// The sources of each file, by part. Sorted, so that the order of the FMUs does not matter.
fn sources(fmus: &[Fmu]) -> BTreeMap<(Part, String), Vec<Source>> {
    let mut files = BTreeMap::<_, Vec<_>>::new();
    for (number, fmu) in fmus.iter().enumerate() {
        for (index, name) in fmu.archive.names.iter().enumerate() {
            if name.is_empty() {
                // An entry for the FMU itself.
                continue;
            }
            // Some systems ignore case in names.
            let folded = name.to_lowercase();
            let part = if name == MODEL_DESCRIPTION {
                Part::ModelDescription
            } else if folded.starts_with("binaries/") {
                Part::Binaries
            } else {
                Part::Rest
            };
            files
                .entry((part, folded))
                .or_default()
                .push((number, index));
        }
    }
    files
}

/// Chooses among the files of one name: the one from the first FMU that has it.
fn choose(
    sources: &[Source],
    fmus: &mut [Fmu],
    notes: &mut Vec<String>,
) -> Result<(String, Packed)> {
    let (first, index) = sources[0];
    let name = fmus[first].archive.names[index].clone();
    let content = fmus[first].content(index)?;
    for &(other, index) in &sources[1..] {
        let other_name = &fmus[other].archive.names[index];
        ensure!(
            *other_name == name,
            "{} has {}, and {} has {}; some systems treat them as the same file",
            fmus[first].path.display(),
            quote(&name),
            fmus[other].path.display(),
            quote(other_name)
        );
        let is_same = fmus[other].content(index)? == content;
        // The content of model descriptions was compared before.
        if is_same || name == MODEL_DESCRIPTION {
            continue;
        }
        let what = format!(
            "{} differs in {} and {}",
            quote(&name),
            fmus[first].path.display(),
            fmus[other].path.display()
        );
        ensure!(is_documentation(&name), "{what}, expected the same bytes");
        notes.push(note(&what, &fmus[first]));
    }
    Ok((name, fmus[first].packed(index)?))
}

/// Whether the file is irrelevant for simulation. Pages may mention when and where they were created.
fn is_documentation(name: &str) -> bool {
    let is_image = |extension| name.starts_with("terminalsAndIcons/") && name.ends_with(extension);
    name.starts_with("documentation/") || name == ICON || is_image(".png") || is_image(".svg")
}

/// A note on a harmless difference, and which FMU was used.
fn note(what: &str, fmu: &Fmu) -> String {
    format!("{what}; kept the one from {}", fmu.path.display())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use tempfile::TempDir;

    use super::*;

    const XML: &str = "<fmiModelDescription guid='1'/>";

    /// A temporary folder with FMUs.
    struct Folder(TempDir);

    impl Folder {
        fn new() -> Self {
            Self(tempfile::tempdir().unwrap())
        }

        fn file(&self, name: &str) -> PathBuf {
            self.0.path().join(name)
        }

        /// Writes an FMU with a model description and other files.
        fn fmu(&self, name: &str, xml: &str, files: &[(&str, &str)]) {
            let packed: Vec<_> = [(MODEL_DESCRIPTION, xml)]
                .iter()
                .chain(files)
                .map(|(name, text)| (*name, Packed::text(text.as_bytes()).unwrap()))
                .collect();
            let entries: Vec<_> = packed
                .iter()
                .map(|(name, file)| Entry::new(*name, file))
                .collect();
            archive::write(&self.file(name), &entries).unwrap();
        }

        /// Merges FMUs to `out`.
        fn merge(&self, files: &[&str]) -> Result<Merged> {
            let files: Vec<_> = files.iter().map(|name| self.file(name)).collect();
            merge(&files, &self.file("out"))
        }

        /// The error of a failed merge, which must not write anything.
        fn error(&self, files: &[&str]) -> String {
            let error = self.merge(files).unwrap_err();
            assert!(!self.file("out").exists());
            format!("{error:#}")
        }

        /// Names and texts of the files in `out`.
        fn merged(&self) -> Vec<(String, String)> {
            let mut archive = Archive::open_sound(&self.file("out")).unwrap();
            let names = archive.names.clone();
            let text = |index| String::from_utf8(archive.content(index).unwrap()).unwrap();
            let texts: Vec<_> = (0..names.len()).map(text).collect();
            names.into_iter().zip(texts).collect()
        }
    }

    #[test]
    fn files_are_merged_in_the_order_of_an_export() {
        let folder = Folder::new();
        let shared = ("documentation/index.html", "page");
        let (linux, windows) = (
            ("binaries/linux64/A.so", "l"),
            ("binaries/win64/A.dll", "w"),
        );
        folder.fmu("a", XML, &[windows, shared, ("model.png", "i")]);
        folder.fmu("b", XML, &[linux, ("resources/r", "r"), shared]);
        folder.merge(&["a", "b"]).unwrap();
        let expected = [
            (MODEL_DESCRIPTION, XML),
            linux,
            windows,
            shared,
            ("model.png", "i"),
            ("resources/r", "r"),
        ];
        assert_eq!(
            folder.merged(),
            expected.map(|(name, text)| (name.to_owned(), text.to_owned()))
        );
        let bytes = fs::read(folder.file("out")).unwrap();
        folder.merge(&["b", "a"]).unwrap();
        assert_eq!(fs::read(folder.file("out")).unwrap(), bytes);
        folder.merge(&["out", "a", "b", "a"]).unwrap();
        assert_eq!(fs::read(folder.file("out")).unwrap(), bytes);
    }

    #[test]
    fn files_relevant_for_simulation_must_be_identical() {
        let folder = Folder::new();
        for name in [
            "binaries/linux64/A.so",
            "resources/r",
            "sources/A.c",
            "extra/e",
        ] {
            folder.fmu("a", XML, &[(name, "1")]);
            folder.fmu("b", XML, &[(name, "2")]);
            let error = folder.error(&["a", "b"]);
            assert!(
                error.contains(&format!(
                    "{name:?} differs in {}",
                    folder.file("a").display()
                )),
                "{error}"
            );
        }
    }

    #[test]
    fn fmus_of_fmi_3_are_merged() {
        let folder = Folder::new();
        let unknown = |dependencies| {
            format!(
                "<fmiModelDescription fmiVersion='3.0' instantiationToken='1'><ModelStructure>
                <Output valueReference='7' dependencies='{dependencies}'/>
                </ModelStructure></fmiModelDescription>"
            )
        };
        let (linux, macos) = (
            ("binaries/x86_64-linux/A.so", "l"),
            ("binaries/aarch64-darwin/A.dylib", "m"),
        );
        let icon = |text| ("terminalsAndIcons/icon.png", text);
        folder.fmu("a", &unknown("1"), &[linux, icon("1")]);
        folder.fmu("b", &unknown("1"), &[macos, icon("2")]);
        let merged = folder.merge(&["a", "b"]).unwrap();
        assert_eq!(merged.platforms, ["aarch64-darwin", "x86_64-linux"]);
        assert_eq!(merged.notes.len(), 1);
        folder.fmu("c", &unknown("2"), &[macos]);
        fs::remove_file(folder.file("out")).unwrap();
        let error = folder.error(&["a", "c"]);
        assert!(error.contains("Output/dependencies"), "{error}");
        folder.fmu(
            "d",
            &unknown("1"),
            &[("terminalsAndIcons/terminalsAndIcons.xml", "1")],
        );
        folder.fmu(
            "e",
            &unknown("1"),
            &[("terminalsAndIcons/terminalsAndIcons.xml", "2")],
        );
        let error = folder.error(&["d", "e"]);
        assert!(error.contains("terminalsAndIcons.xml"), "{error}");
    }

    #[test]
    fn documentation_is_taken_from_the_first_fmu() {
        let folder = Folder::new();
        let files = |text| [("documentation/index.html", text), ("model.png", text)];
        folder.fmu(
            "a",
            "<fmiModelDescription generationTool='1'/>",
            &files("1"),
        );
        folder.fmu(
            "b",
            "<fmiModelDescription generationTool='2'/>",
            &files("2"),
        );
        folder.merge(&["b", "a"]).unwrap();
        for (name, text) in folder.merged() {
            assert!(text.contains('2') && !text.contains('1'), "{name}: {text}");
        }
    }

    #[test]
    fn names_that_differ_in_case_are_rejected() {
        let folder = Folder::new();
        folder.fmu("a", XML, &[("binaries/linux64/A.so", "")]);
        folder.fmu("b", XML, &[("Binaries/linux64/a.so", "")]);
        let error = folder.error(&["a", "b"]);
        assert!(error.contains("\"Binaries/linux64/a.so\""), "{error}");
    }

    #[test]
    fn every_fmu_is_compared() {
        let folder = Folder::new();
        folder.fmu("a", XML, &[]);
        folder.fmu("b", XML, &[]);
        folder.fmu("c", "<fmiModelDescription guid='2'/>", &[]);
        let error = folder.error(&["a", "b", "c"]);
        let (a, c) = (folder.file("a"), folder.file("c"));
        let line = format!("guid: \"1\" in {}, \"2\" in {}", a.display(), c.display());
        assert!(error.contains(&line), "{error}");
        assert!(!error.contains("and more"), "{error}");
    }

    #[test]
    fn files_that_are_not_fmus_are_rejected() {
        let folder = Folder::new();
        folder.fmu("a", XML, &[]);
        fs::write(folder.file("text"), "no archive").unwrap();
        folder.fmu("other", "<html/>", &[]);
        folder.fmu("broken", "<a>", &[]);
        for bad in ["text", "other", "broken", "missing"] {
            for files in [["a", bad], [bad, "a"]] {
                let error = folder.error(&files);
                let path = folder.file(bad).display().to_string();
                assert!(error.starts_with(&path), "{error}");
            }
        }
    }

    #[test]
    fn a_single_fmu_is_rejected() {
        let folder = Folder::new();
        folder.fmu("a", XML, &[]);
        assert!(folder.error(&["a"]).contains("two or more"));
    }

    #[test]
    fn damage_never_reaches_the_output() {
        let folder = Folder::new();
        folder.fmu("a", XML, &[("binaries/linux64/A.so", "the program")]);
        folder.merge(&["a", "a"]).unwrap();
        let expected = folder.merged();
        let sound = fs::read(folder.file("a")).unwrap();
        for position in 0..sound.len() {
            let mut damaged = sound.clone();
            damaged[position] ^= 0x55;
            fs::write(folder.file("damaged"), damaged).unwrap();
            if folder.merge(&["damaged", "damaged"]).is_ok() {
                // Names have no checksum.
                let texts = |files: &[(String, String)]| {
                    let texts = files.iter().map(|(_, text)| text.clone());
                    texts.collect::<Vec<_>>()
                };
                assert_eq!(texts(&folder.merged()), texts(&expected), "at {position}");
            }
        }
    }
}
