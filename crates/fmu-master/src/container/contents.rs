//! The files of a container: its resources are the system file, the unpacked FMUs, and the table of inputs.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{ExportedModel, FmiVersion};
use fmu_file::archive::relative;
use fmu_file::platform::Platform;
use toml::de::{DeTable, DeValue};

use super::text::quoted;
use super::{Interface, SYSTEM_FILE, in_container};
use crate::{Description, Fmu, Plan};

/// What a container has besides its binaries.
pub struct Contents {
    /// What its XML describes.
    pub model: ExportedModel,
    /// The files below `resources`, by their paths there.
    pub resources: Vec<(String, Vec<u8>)>,
    /// What is missing, and what hosts cannot do.
    pub notes: Vec<String>,
    /// The names of the components, the file names of their FMUs, and the platform folders of these.
    pub components: Vec<(String, String, BTreeSet<String>)>,
}

impl Contents {
    /// The contents of a container of this name, for a version of FMI. `text` is the text of the system file, in TOML.
    ///
    /// # Errors
    /// The system is invalid, as for [`Plan::new`], or an FMU cannot be in a container.
    pub fn new(
        description: &Description,
        text: &str,
        name: &str,
        version: FmiVersion,
    ) -> Result<Self> {
        let description = in_container(description.clone());
        let plan = Plan::new(&description)?;
        let interface = Interface::new(&description, &plan)?;
        let model = interface.model(name, &description);
        let (mut resources, mut folders) = (Vec::new(), BTreeMap::new());
        let mut components = Vec::new();
        for component in plan.components.iter() {
            let (name, fmu) = (&component.name, &component.fmu);
            let unpacked = unpacked(name, fmu)?;
            let platforms = subfolders(&unpacked.join("binaries"))?;
            components.push((name.clone(), fmu.file_name(), platforms));
            if folders.contains_key(&fmu.path) {
                continue;
            }
            let folder = unused_name(&fmu.path, folders.values());
            add_files(unpacked, &folder, &mut resources)
                .with_context(|| format!("{} cannot be packed", fmu.path.display()))?;
            folders.insert(fmu.path.clone(), folder);
        }
        let folders = description.components.iter().map(|component| &*folders[&component.fmu]);
        let input = description.input.as_ref().map(|input| {
            let extension = input.extension().unwrap_or_default().to_string_lossy();
            (format!("input.{extension}"), input)
        });
        let input_name = input.as_ref().map(|(name, _)| &**name);
        let text = with_files(text, &Vec::from_iter(folders), input_name)?;
        resources.push((SYSTEM_FILE.to_owned(), text.into_bytes()));
        if let Some((name, file)) = input {
            let content = fs::read(file);
            let content = content.with_context(|| format!("cannot read {}", file.display()))?;
            resources.push((name, content));
        }
        resources.sort();
        let left_out = Interface::left_out(&model, version).into_iter();
        let left_out =
            left_out.map(|reason| format!("left out in FMI {}: {reason}", version.as_str()));
        let unsaved = interface.unsavable.iter();
        let unsaved = unsaved.map(|reason| format!("hosts cannot save its state: {reason}"));
        let notes = left_out.chain(unsaved).collect();
        Ok(Self { model, resources, notes, components })
    }

    /// Checks that all FMUs have a binary for a platform.
    ///
    /// # Errors
    /// One has none; the error names it and the platforms that it has.
    pub fn check_platform(&self, platform: &Platform) -> Result<()> {
        for (name, file, has) in &self.components {
            ensure!(
                has.iter().any(|folder| platform.is_named(folder)),
                "component {name}: {file} has no binary for {}, only for {}",
                platform.folder,
                Vec::from_iter(has.iter().map(String::as_str)).join(", ")
            );
        }
        Ok(())
    }
}

/// The folder with the files of an FMU.
fn unpacked<'a>(name: &str, fmu: &'a Fmu) -> Result<&'a Path> {
    if fmu.is_component() {
        bail!(
            "component {name}: {} has no binary for this machine but a WebAssembly component, which a container cannot run",
            fmu.file_name()
        );
    }
    let binary = fmu.binary();
    binary
        .map(|binary| binary.folder.path())
        .with_context(|| format!("component {name} is a function, which a container cannot have"))
}

/// A name for the folder of an FMU in the resources that no other folder has.
fn unused_name<'a>(fmu: &Path, used: impl Iterator<Item = &'a String> + Clone) -> String {
    let stem = fmu.file_stem().unwrap_or_default().to_string_lossy();
    let is_safe = |c: char| c.is_ascii_alphanumeric() || "_-".contains(c);
    let stem: String = stem.chars().map(|c| if is_safe(c) { c } else { '_' }).collect();
    let names = [stem.clone()].into_iter().chain((2..).map(|n| format!("{stem}-{n}")));
    // Some systems ignore upper and lower case.
    let is_used = |name: &String| used.clone().any(|other| other.eq_ignore_ascii_case(name));
    names.into_iter().find(|name| !is_used(name)).unwrap_or(stem)
}

/// The names of the folders in a folder.
fn subfolders(folder: &Path) -> Result<BTreeSet<String>> {
    let entries = fs::read_dir(folder)?.filter_map(Result::ok);
    let folders = entries.filter(|entry| entry.path().is_dir());
    Ok(folders.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect())
}

/// Adds all files of a folder, whose paths begin with `prefix`.
fn add_files(folder: &Path, prefix: &str, files: &mut Vec<(String, Vec<u8>)>) -> Result<()> {
    for entry in fs::read_dir(folder)? {
        let path: PathBuf = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = relative(&format!("{prefix}/{name}")).map_err(anyhow::Error::msg)?;
        match path.is_dir() {
            true => add_files(&path, &name, files)?,
            false => files.push((name, fs::read(&path)?)),
        }
    }
    Ok(())
}

/// A system file with other files of FMUs, by component, and another input file.
fn with_files(text: &str, fmus: &[&str], input: Option<&str>) -> Result<String> {
    let document = DeTable::parse(text)?;
    let mut replaced = Vec::new();
    if let Some(DeValue::Array(components)) =
        document.get_ref().get("component").map(|value| value.get_ref())
    {
        for (component, file) in components.iter().zip(fmus) {
            if let DeValue::Table(table) = component.get_ref()
                && let Some(fmu) = table.get("fmu")
            {
                replaced.push((fmu.span(), *file));
            }
        }
    }
    ensure!(
        replaced.len() == fmus.len(),
        "the system file does not name the FMU of each component"
    );
    let file = document.get_ref().get("input");
    replaced.extend(file.into_iter().flat_map(|file| Some((file.span(), input?))));
    replaced.sort_by_key(|(span, _)| span.start);
    let mut text = text.to_owned();
    for (span, file) in replaced.into_iter().rev() {
        text.replace_range(span, &quoted(file));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_system_file_names_the_packed_files() {
        let text = "step = 1e-3 # of both\ninput = 'a/b.csv'\n[[component]]\nname = \"a\"\nfmu = \"../x y.fmu\"\n\
            start = { fmu = 3 }\n[[component]]\nfmu = \"\"\"z\"\"\"\n";
        let expected = "step = 1e-3 # of both\ninput = \"input.csv\"\n[[component]]\nname = \"a\"\nfmu = \"x_y\"\n\
            start = { fmu = 3 }\n[[component]]\nfmu = \"z\"\n";
        assert_eq!(with_files(text, &["x_y", "z"], Some("input.csv")).unwrap(), expected);
    }

    #[test]
    fn folders_have_different_names_on_every_system() {
        let name = |file: &str, used: &[&str]| {
            let used = Vec::from_iter(used.iter().map(|name| (*name).to_owned()));
            unused_name(Path::new(file), used.iter())
        };
        assert_eq!(name("a/Pid.fmu", &[]), "Pid");
        assert_eq!(name("b/pid.fmu", &["Pid"]), "pid-2");
        assert_eq!(name("ü 1.fmu", &[]), "__1");
    }
}
