//! Exports systems as System Structure and Parameterization (SSP) 1.0 packages.

mod layout;
mod structure;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{FmiVersion, Type};
use fmu_file::archive::{self, Packed};

use crate::{Description, Messages, Order, Plan, Planned};

/// A package that is ready to be written.
pub struct Package {
    /// The file that it is written to.
    pub file: PathBuf,
    /// What tools may do differently from this system, to follow the name of the file in a message.
    pub warnings: Vec<String>,
    structure: String,
    resources: Resources,
}

impl Package {
    /// Builds the package of a system, which is written to `folder` under the name of the system file.
    ///
    /// # Errors
    /// Something in the system does not fit, or an FMU rejects a start value.
    pub fn new(system: &Path, description: &Description, folder: &Path) -> Result<Self> {
        let pack = || {
            let plan = Plan::new(description)?;
            let components = &plan.components;
            for Planned { fmu, .. } in components {
                ensure!(
                    fmu.version == FmiVersion::Fmi2,
                    "{} is of FMI {}, expected 2.0: SSP 1.0 has no arrays",
                    fmu.file_name(),
                    fmu.version.as_str()
                );
            }
            // The FMUs themselves check their start values.
            plan.simulate(&[], &Messages::default())?;
            let mut resources = Resources::default();
            let paths = components.iter().map(|c| resources.add(&c.fmu.path));
            let paths = paths.collect::<Result<Vec<_>>>()?;
            let name = system.file_stem().unwrap_or_default().to_string_lossy();
            let names = distinct(&Vec::from_iter(components.iter().map(|c| c.name.as_str())))?;
            anyhow::Ok(Self {
                warnings: warnings(description.order, components, &names),
                structure: structure::document(&name, description, &plan, &names, &paths)?,
                file: folder.join(format!("{name}.ssp")),
                resources,
            })
        };
        pack().with_context(|| system.display().to_string())
    }

    /// Writes the package and returns its size in bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self) -> Result<u64> {
        let structure = Packed::text(self.structure.as_bytes())?;
        let mut entries = vec![("SystemStructure.ssd".to_owned(), &structure)];
        let resources = self.resources.0.values();
        entries.extend(resources.map(|file| (file.place(), &file.packed)));
        archive::write(&self.file, &entries)
    }
}

fn warnings(order: Order, components: &[Planned], identifiers: &[String]) -> Vec<String> {
    let mut warnings = Vec::new();
    if order == Order::Sequential {
        warnings.push(
            "cannot state that the system steps in sequential order; most tools step in parallel"
                .into(),
        );
    }
    for (component, identifier) in components.iter().zip(identifiers) {
        let name = &component.name;
        if name != identifier {
            warnings.push(format!(
                "names the component {name:?} {identifier}: OMSimulator requires identifiers"
            ));
        }
        let starts = component.starts();
        for (variable, _) in starts.filter(|(v, _)| v.of_type == Type::Enumeration) {
            warnings.push(format!(
                "sets {name}.{}, an enumeration, which Ecos and libcosim reject and OMSimulator may ignore; use an FMU that starts with this value, such as a variant",
                variable.name
            ));
        }
    }
    warnings
}

/// The name in a package, an identifier, as OMSimulator requires: other characters than ASCII letters, digits
/// and `_` become `_`, and `c_` comes before one that does not begin with a letter.
fn identifier(name: &str) -> String {
    let valid = name.replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    match valid.starts_with(|c: char| c.is_ascii_alphabetic()) {
        true => valid,
        false => format!("c_{valid}"),
    }
}

/// The names of components in a package, which must be different.
fn distinct(names: &[&str]) -> Result<Vec<String>> {
    let converted: Vec<String> = names.iter().map(|name| identifier(name)).collect();
    for (i, name) in converted.iter().enumerate() {
        if let Some(other) = converted[..i].iter().position(|known| known == name) {
            let (one, two) = (names[other], names[i]);
            bail!(
                "the components {one:?} and {two:?} would both have the name {name} in the package; rename one"
            );
        }
    }
    Ok(converted)
}

/// The FMUs of a package by their names in it, each stored once. Some file systems do not distinguish "a" from
/// "A", so the names are in lower case.
#[derive(Default)]
struct Resources(BTreeMap<String, File>);

struct File {
    path: PathBuf,
    content: Vec<u8>,
    packed: Packed,
}

impl File {
    /// Its path in the package: the file name without characters that are not allowed in a URI.
    fn place(&self) -> String {
        let name = self.path.file_name().unwrap_or_default().to_string_lossy();
        let is_other = |c: char| !(c.is_ascii_alphanumeric() || "._-".contains(c));
        format!("resources/{}", name.replace(is_other, "_"))
    }
}

impl Resources {
    /// Adds an FMU unless it is already there; returns its path in the package. A different FMU must not
    /// have the same name.
    fn add(&mut self, fmu: &Path) -> Result<String> {
        let content = fs::read(fmu).with_context(|| format!("cannot read {}", fmu.display()))?;
        let file = File {
            path: fmu.to_owned(),
            packed: Packed::stored(&content)?,
            content,
        };
        let place = file.place();
        let known = self.0.entry(place.to_ascii_lowercase()).or_insert(file);
        ensure!(
            known.path == fmu || fs::read(fmu)? == known.content && known.place() == place,
            "{} and {} are different FMUs that would have the same name in the package; rename one",
            known.path.display(),
            fmu.display()
        );
        Ok(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_identifiers_and_different() {
        for (name, expected) in [
            ("supervisor_plant", "supervisor_plant"),
            ("pid-rbf", "pid_rbf"),
            ("2nd stage", "c_2nd_stage"),
            ("_a", "c__a"),
            ("Régler", "R_gler"),
            ("", "c_"),
        ] {
            assert_eq!(identifier(name), expected);
        }
        let error = distinct(&["a-b", "c", "a b"]).unwrap_err().to_string();
        assert!(error.contains(r#""a-b" and "a b" would both have the name a_b"#));
    }

    #[test]
    fn an_fmu_is_stored_once_and_different_ones_have_different_names() {
        let folder = tempfile::tempdir().unwrap();
        let mut resources = Resources::default();
        for (file, content, place) in [
            ("A.fmu", "a", Some("A.fmu")),
            ("copy/A.fmu", "a", Some("A.fmu")),
            ("B & C #1.fmu", "a", Some("B___C__1.fmu")),
            ("other/A.fmu", "b", None),
            ("other/a.fmu", "a", None),
            ("B_& C #1.fmu", "b", None),
        ] {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, content).unwrap();
            let expected = place.map(|place| format!("resources/{place}"));
            assert_eq!(resources.add(&path).ok(), expected, "{file}");
        }
        assert_eq!(resources.0.len(), 2);
    }
}
