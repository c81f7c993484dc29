//! Writes a system as a package (.ssp).

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::Type;
use fmu_file::archive::{self, Packed};

use super::structure::identifier;
use super::{document, structure};
use crate::package::STRUCTURE_FILE;
use crate::{Description, Inputs, Messages, Order, Plan};

/// A package that is ready to be written.
pub struct Package {
    /// The file that it is written to.
    pub file: PathBuf,
    /// What tools may do differently from this system, to follow the name of the file in a message.
    pub warnings: Vec<String>,
    entries: Vec<(String, Packed)>,
}

impl Package {
    /// Builds the package of a system, which is written to `folder` under the name of the system file.
    ///
    /// # Errors
    /// Something in the system does not fit, or an FMU rejects a start value.
    pub fn new(system: &Path, description: &Description, folder: &Path) -> Result<Self> {
        let pack = || {
            let plan = Plan::new(description)?;
            // The FMUs themselves check their start values.
            plan.simulate(&[], &Messages::default())?;
            let mut fmus = PackedFmus::default();
            let places = plan.components.iter().map(|c| fmus.add(&c.fmu.path));
            let places = places.collect::<Result<Vec<_>>>()?;
            let name = system.file_stem().unwrap_or_default().to_string_lossy();
            let names = distinct(&Vec::from_iter(plan.components.iter().map(|c| &*c.name)))?;
            let structure = structure::document(&name, &plan, &names, &places)?;
            document::check(&structure).context("its package would be too large")?;
            let structure = Packed::text(structure.as_bytes())?;
            let mut entries = vec![(STRUCTURE_FILE.to_owned(), structure)];
            for (place, _, content) in fmus.0.into_values() {
                entries.push((place, Packed::stored(&content)?));
            }
            anyhow::Ok(Self {
                file: folder.join(format!("{name}.ssp")),
                warnings: warnings(description, &plan, &names),
                entries,
            })
        };
        pack().with_context(|| system.display().to_string())
    }

    /// Writes the package and returns its size in bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self) -> Result<u64> {
        let entries = self.entries.iter().map(|(place, file)| (place, file));
        archive::write(&self.file, &Vec::from_iter(entries))
    }
}

fn warnings(description: &Description, plan: &Plan, identifiers: &[String]) -> Vec<String> {
    let mut warnings = Vec::new();
    let order = match plan.order {
        Order::Sequential => Some("sequential"),
        Order::Implicit => Some("implicit"),
        Order::Parallel => None,
    };
    warnings.extend(order.map(|order| {
        format!("cannot state that the system steps in {order} order; most tools step in parallel")
    }));
    let components = &description.components;
    let has_tolerance =
        description.tolerance.is_some() || components.iter().any(|c| c.tolerance.is_some());
    let has_solver = description.solver.is_some() || components.iter().any(|c| c.solver.is_some());
    for (key, is_given) in [
        ("input", description.input.is_some()),
        ("output_step", description.output_step.is_some()),
        ("event_mode", components.iter().any(|c| c.event_mode.is_some())),
        ("inputs", components.iter().any(|c| c.inputs != Inputs::Held)),
        ("step of components", components.iter().any(|c| c.step.is_some())),
        ("tolerance", has_tolerance),
        ("solver", has_solver),
        ("sampled", components.iter().any(|c| c.sampled.is_some())),
        ("algebraic_loops", description.algebraic_loops.is_some()),
    ] {
        if is_given {
            warnings.push(format!("leaves out the key {key}, which SSP does not know"));
        }
    }
    for connection in plan.connections.iter().filter(|c| !c.faults.is_empty()) {
        warnings.push(format!(
            "leaves out the faults of {} -> {}, which SSP does not know",
            connection.from.name(&plan.components),
            connection.to.name(&plan.components)
        ));
    }
    for (component, identifier) in plan.components.iter().zip(identifiers) {
        let name = &component.name;
        if name != identifier {
            warnings.push(format!(
                "names the component {name:?} {identifier}: OMSimulator requires identifiers"
            ));
        }
        for (variable, _) in component.starts().filter(|(v, _)| v.of_type == Type::Clock) {
            warnings.push(format!(
                "leaves out the start value of the clock {name}.{}, which SSP does not know",
                variable.name
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
    // Elements of one array.
    warnings.dedup();
    warnings
}

/// The names of components in a package, which must be different.
fn distinct(names: &[&str]) -> Result<Vec<String>> {
    let converted: Vec<String> = names.iter().map(|name| identifier(name)).collect();
    let mut known = HashMap::new();
    for (name, two) in converted.iter().zip(names) {
        if let Some(one) = known.insert(name, two) {
            bail!(
                "the components {one:?} and {two:?} would both have the name {name} in the package; rename one"
            );
        }
    }
    Ok(converted)
}

/// The FMUs of a package, each stored once: its path in the package, its file and its content. Some file systems
/// do not distinguish "a" from "A", so the keys are the paths in lower case.
#[derive(Default)]
struct PackedFmus(BTreeMap<String, (String, PathBuf, Vec<u8>)>);

impl PackedFmus {
    /// Adds an FMU unless it is already there; returns its path in the package: the file name without
    /// characters that are not allowed in a URI. A different FMU must not have the same name.
    fn add(&mut self, fmu: &Path) -> Result<String> {
        let content = fs::read(fmu).with_context(|| format!("cannot read {}", fmu.display()))?;
        let name = fmu.file_name().unwrap_or_default().to_string_lossy();
        let is_other = |c: char| !(c.is_ascii_alphanumeric() || "._-".contains(c));
        let file = format!("resources/{}", name.replace(is_other, "_"));
        let new = (file.clone(), fmu.to_owned(), content.clone());
        let (place, known, stored) = self.0.entry(file.to_ascii_lowercase()).or_insert(new);
        ensure!(
            *place == file && *stored == content,
            "{} and {} are different FMUs that would have the same name in the package; rename one",
            known.display(),
            fmu.display()
        );
        Ok(file)
    }
}
