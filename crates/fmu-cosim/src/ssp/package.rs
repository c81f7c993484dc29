//! An SSP package and the contents of its archive.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use fmu_file::archive::{self, Entry, Packed};

use fmu_description::{FmiVersion, VariableType};

use crate::{Description, Order, Plan, Planned};

use super::resources::Resources;
use super::{names, structure};

/// A package that is ready to be written.
pub struct Package {
    file: PathBuf,
    structure: String,
    resources: Resources,
    warnings: Vec<String>,
}

impl Package {
    /// Builds the package of a system, which is written to `folder` under the name of the system file.
    ///
    /// # Errors
    /// Something in the system does not fit, or an FMU rejects a start value.
    pub fn new(system: &Path, description: &Description, folder: &Path) -> Result<Self> {
        let pack = || {
            let plan = Plan::new(description)?;
            if let Some(other) =
                (plan.components().iter()).find(|c| c.fmu.version != FmiVersion::Fmi2)
            {
                bail!(
                    "{} is of FMI {}, expected 2.0: SSP 1.0 has no arrays",
                    other.fmu.file_name(),
                    other.fmu.version.as_str()
                );
            }
            // The FMUs themselves check their start values.
            plan.simulate(&[])?;
            let mut resources = Resources::default();
            let paths = plan
                .components()
                .iter()
                .map(|component| resources.add(&component.fmu.path))
                .collect::<Result<Vec<_>>>()?;
            let name = system.file_stem().unwrap_or_default().to_string_lossy();
            let components: Vec<_> = plan.components().iter().map(|c| c.name.as_str()).collect();
            let identifiers = names::distinct(&components)?;
            anyhow::Ok(Self {
                warnings: warnings(description.order, plan.components(), &identifiers),
                structure: structure::document(&name, description, &plan, &identifiers, &paths)?,
                file: folder.join(format!("{name}.ssp")),
                resources,
            })
        };
        pack().with_context(|| system.display().to_string())
    }

    /// The file that it is written to.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// What tools may do differently from this system, to follow the name of the file in a message.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Writes the package and returns its size in bytes.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self) -> Result<u64> {
        let structure = Packed::text(self.structure.as_bytes())?;
        let entries: Vec<_> = [Entry::new("SystemStructure.ssd", &structure)]
            .into_iter()
            .chain(self.resources.entries())
            .collect();
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
        for (variable, _) in starts.filter(|(v, _)| v.kind == VariableType::Enumeration) {
            warnings.push(format!(
                "sets {name}.{}, an enumeration, which Ecos and libcosim reject and OMSimulator may ignore; use an FMU that starts with this value, such as a variant",
                variable.name
            ));
        }
    }
    warnings
}
