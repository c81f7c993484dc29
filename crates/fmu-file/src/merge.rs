//! Merges FMUs of one model that were built on several machines into one FMU for all platforms.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::{self, Element};

use crate::archive::{self, Archive, ICON, MODEL_DESCRIPTION, Packed};
use crate::platform;
use crate::text::{about, plain, quote};

/// Maximum number of differences between two model descriptions.
const MAX_DIFFERENCES: usize = 100;
/// Maximum number of differences shown.
const MAX_SHOWN: usize = 20;
/// Maximum length of a path or value that is shown.
const MAX_LENGTH: usize = 300;

/// Attributes of the root element that describe the export, not the model.
const EXPORT_ATTRIBUTES: [&str; 2] = ["generationTool", "generationDateAndTime"];
/// Tool-specific elements, which have no meaning for other tools.
const TOOL_ELEMENTS: [&str; 2] = ["VendorAnnotations", "Annotations"];

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
struct Candidate {
    path: PathBuf,
    archive: Archive,
    description: String,
}

/// The source of a file: the index of the FMU, and the index of the file in it.
type Source = (usize, usize);

/// The sections of an FMU, in the order in which `cargo fmu export` writes them.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Section {
    ModelDescription,
    Binaries,
    Rest,
}

/// Merges two or more FMUs and writes the result to `out`, which may be one of them.
///
/// # Errors
/// An FMU cannot be read or does not match the others, or `out` cannot be written.
pub fn merge(files: &[PathBuf], out: &Path) -> Result<Merged> {
    ensure!(files.len() > 1, "got {} FMU, expected two or more", files.len());
    let mut notes = Vec::new();
    let mut fmus = files.iter().map(|path| Candidate::open(path)).collect::<Result<Vec<_>>>()?;
    for other in &fmus[1..] {
        check_same_model(&fmus[0], other, &mut notes)?;
    }
    let files = sources(&fmus)
        .into_values()
        .map(|sources| choose(&sources, &mut fmus, &mut notes))
        .collect::<Result<Vec<_>>>()?;
    // Windows does not replace open files.
    drop(fmus);
    let entries: Vec<_> = files.iter().map(|(name, file)| (name, file)).collect();
    let platforms = platform::folders(files.iter().map(|(name, _)| name));
    Ok(Merged {
        size: archive::write(out, &entries)?,
        platforms: platforms.into_iter().map(str::to_owned).collect(),
        notes,
    })
}

impl Candidate {
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
        Ok(Self { path: path.to_owned(), archive, description })
    }

    fn content(&mut self, file: usize) -> Result<Vec<u8>> {
        let content = self.archive.content(file);
        content.map_err(|error| about(&self.path, &error))
    }
}

fn root(description: &str) -> Result<Element<'_>> {
    xml::parse(description).with_context(|| format!("{MODEL_DESCRIPTION} cannot be read"))
}

// --- files ----------------------------------------------------------------------------------------

/// The sources of each file, by part. Sorted, so that the order of the FMUs does not matter.
fn sources(fmus: &[Candidate]) -> BTreeMap<(Section, String), Vec<Source>> {
    let mut files = BTreeMap::<_, Vec<_>>::new();
    for (number, fmu) in fmus.iter().enumerate() {
        for (index, name) in fmu.archive.names.iter().enumerate() {
            // Some systems ignore case in names.
            let folded = name.to_lowercase();
            let part = match name.as_str() {
                // An entry for the FMU itself.
                "" => continue,
                MODEL_DESCRIPTION => Section::ModelDescription,
                _ if folded.starts_with("binaries/") => Section::Binaries,
                _ => Section::Rest,
            };
            let sources = files.entry((part, folded)).or_default();
            sources.push((number, index));
        }
    }
    files
}

/// Chooses among the files of one name: the one from the first FMU that has it.
fn choose(
    sources: &[Source],
    fmus: &mut [Candidate],
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
    let packed = fmus[first].archive.packed(index);
    let packed = packed.map_err(|error| about(&fmus[first].path, &error))?;
    Ok((name, packed))
}

/// Whether the file is irrelevant for simulation. Pages may mention when and where they were created.
fn is_documentation(name: &str) -> bool {
    let is_image = |extension| name.starts_with("terminalsAndIcons/") && name.ends_with(extension);
    name.starts_with("documentation/") || name == ICON || is_image(".png") || is_image(".svg")
}

/// A note on a harmless difference, and which FMU was used.
fn note(what: &str, fmu: &Candidate) -> String {
    format!("{what}; kept the one from {}", fmu.path.display())
}

// --- model descriptions ---------------------------------------------------------------------------

/// Checks that two model descriptions agree, and notes harmless differences.
fn check_same_model(first: &Candidate, other: &Candidate, notes: &mut Vec<String>) -> Result<()> {
    let (left, right) = (root(&first.description)?, root(&other.description)?);
    let mut differences = Vec::new();
    compare("", &left, &right, &mut differences);
    let (harmless, conflicts): (Vec<_>, Vec<_>) =
        differences.into_iter().partition(|(path, _)| EXPORT_ATTRIBUTES.contains(&path.as_str()));
    let shown = |(path, values): &Difference| {
        let [left, right] = values.each_ref().map(|value| match value {
            Some(value) => plain(value, MAX_LENGTH),
            None => "nothing".into(),
        });
        format!(
            "{}: {left} in {}, {right} in {}",
            plain(path, MAX_LENGTH),
            first.path.display(),
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
    notes.extend(harmless.iter().map(|difference| note(&shown(difference), first)));
    Ok(())
}

/// The path of an attribute or element that differs between two model descriptions, and its value in each
/// of them; `None` if missing.
type Difference = (String, [Option<String>; 2]);

/// Adds the first differences between two elements, in order; the path of the root is empty.
fn compare(path: &str, left: &Element<'_>, right: &Element<'_>, found: &mut Vec<Difference>) {
    // The order of attributes is irrelevant.
    let of_left = left.attributes.iter().map(|(name, _)| *name);
    let of_right = right.attributes.iter().map(|(name, _)| *name);
    for name in of_left.chain(of_right.filter(|name| left.attribute(name).is_none())) {
        let values = [left, right].map(|element| element.attribute(name));
        if values[0] != values[1] {
            found.push((below(path, name), quoted(values)));
        }
    }
    let parent = if path.is_empty() { left.name } else { path };
    let [in_left, in_right] =
        [left, right].map(|element| children(element).map(label).collect::<HashSet<_>>());
    let (mut of_left, mut of_right) = (children(left).peekable(), children(right).peekable());
    while found.len() < MAX_DIFFERENCES {
        let next = [of_left.peek(), of_right.peek()].map(Option::<&&_>::copied);
        let labels = match (next, next.map(|element| element.map(label))) {
            ([None, None], _) => return,
            ([Some(left), Some(right)], [Some(label), Some(other)]) if label == other => {
                compare(&below(path, &shown(label)), left, right, found);
                of_left.next();
                of_right.next();
                continue;
            }
            (_, [Some(left), _]) if !in_right.contains(&left) => {
                of_left.next();
                [Some(left), None]
            }
            (_, [_, Some(right)]) if !in_left.contains(&right) => {
                of_right.next();
                [None, Some(right)]
            }
            // The order differs, so the elements that follow cannot be paired.
            (_, labels) => {
                found.push((parent.to_owned(), labels.map(|label| label.map(shown))));
                return;
            }
        };
        found.push((parent.to_owned(), labels.map(|label| label.map(shown))));
    }
}

/// Two different values in quotes, without most of a long beginning that they share.
fn quoted(values: [Option<&str>; 2]) -> [Option<String>; 2] {
    let [left, right] = values.map(|value| value.unwrap_or_default().chars());
    let common = left.zip(right).take_while(|(left, right)| left == right).count();
    let (dots, hidden) = if common < 60 { ("", 0) } else { ("...", common - 20) };
    let rest = |value: &str| value.chars().skip(hidden).collect::<String>();
    values.map(|value| value.map(|value| format!("{dots}{}", quote(&rest(value)))))
}

/// The path of a child or attribute.
fn below(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") }
}

fn children<'a, 'b>(element: &'a Element<'b>) -> impl Iterator<Item = &'a Element<'b>> {
    let of_the_model = |child: &&Element<'_>| !TOOL_ELEMENTS.contains(&child.name);
    element.children.iter().filter(of_the_model)
}

/// The name of an element, and its attribute `name`.
type Label<'a> = (&'a str, Option<&'a str>);

fn label<'a>(element: &'a Element<'_>) -> Label<'a> {
    (element.name, element.attribute("name"))
}

fn shown((element, name): Label<'_>) -> String {
    match name {
        Some(name) => format!("{element} {}", quote(name)),
        None => element.to_owned(),
    }
}

/// `tests/cmd/merge.txt` of the command line has what is refused, and what is noted.
#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const XML: &str = "<fmiModelDescription guid='1'/>";

    /// An FMU with a model description and other files.
    fn fmu(xml: &str, files: &[(&str, &str)]) -> Vec<u8> {
        let files = [&[(MODEL_DESCRIPTION, xml)], files].concat();
        let packed = files.iter().map(|(_, text)| Packed::text(text.as_bytes()));
        let packed = packed.collect::<Result<Vec<_>>>().unwrap();
        let entries = files.iter().zip(&packed).map(|((name, _), file)| (*name, file));
        archive::zip(&Vec::from_iter(entries)).unwrap()
    }

    /// Merges FMUs with the file names a, b and so on.
    fn merged(fmus: &[&Vec<u8>]) -> Result<(Merged, Vec<u8>), String> {
        let folder = tempfile::tempdir().unwrap();
        let files = ('a'..).zip(fmus).map(|(name, fmu)| {
            let file = folder.path().join(name.to_string());
            fs::write(&file, fmu).unwrap();
            file
        });
        let out = folder.path().join("out");
        let merged = merge(&Vec::from_iter(files), &out);
        assert_eq!(merged.is_ok(), out.exists());
        let place = format!("{}/", folder.path().display());
        let merged = merged.map_err(|error| format!("{error:#}").replace(&place, ""))?;
        Ok((merged, fs::read(out).unwrap()))
    }

    /// Names and texts of the files of an FMU.
    fn texts(fmu: &[u8]) -> Vec<(String, String)> {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(file.path(), fmu).unwrap();
        let mut archive = Archive::open_sound(file.path()).unwrap();
        let names = archive.names.clone().into_iter().enumerate();
        let mut text = |index| String::from_utf8(archive.content(index).unwrap()).unwrap();
        names.map(|(index, name)| (name, text(index))).collect()
    }

    #[test]
    fn files_are_merged_in_the_order_of_an_export() {
        let shared = ("documentation/index.html", "page");
        let (linux, windows) = (("binaries/linux64/A.so", "l"), ("binaries/win64/A.dll", "w"));
        let (icon, resource) = (("model.png", "i"), ("resources/r", "r"));
        let (a, b) = (fmu(XML, &[windows, shared, icon]), fmu(XML, &[linux, resource, shared]));
        let (found, out) = merged(&[&a, &b]).unwrap();
        assert_eq!(found.platforms, ["linux64", "win64"]);
        let expected = [(MODEL_DESCRIPTION, XML), linux, windows, shared, icon, resource];
        let expected = expected.map(|(name, text)| (name.to_owned(), text.to_owned()));
        assert_eq!(texts(&out), expected);
        for order in [&[&b, &a][..], &[&out, &a, &b, &a]] {
            assert_eq!(merged(order).unwrap().1, out);
        }
    }

    #[test]
    fn damage_never_reaches_the_output() {
        let sound = fmu(XML, &[("binaries/linux64/A.so", "the program")]);
        // Names have no checksum.
        let contents = |fmu: &[u8]| Vec::from_iter(texts(fmu).into_iter().map(|(_, text)| text));
        let expected = contents(&sound);
        for position in 0..sound.len() {
            let mut damaged = sound.clone();
            damaged[position] ^= 0x55;
            if let Ok((_, out)) = merged(&[&damaged, &damaged]) {
                assert_eq!(contents(&out), expected, "at {position}");
            }
        }
    }
}
