//! An SSP package and the contents of its archive.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fmu_file::archive::{self, Entry, Packed};

use crate::{Description, Order, Plan};

use super::resources::Resources;
use super::structure;

/// A package that is ready to be written.
pub struct Package {
    file: PathBuf,
    structure: String,
    resources: Resources,
    order: Order,
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
            plan.simulate(&[])?;
            let mut resources = Resources::default();
            let paths = plan
                .components()
                .iter()
                .map(|component| resources.add(&component.fmu.path))
                .collect::<Result<Vec<_>>>()?;
            let name = system.file_stem().unwrap_or_default().to_string_lossy();
            anyhow::Ok(Self {
                structure: structure::document(&name, description, &plan, &paths)?,
                file: folder.join(format!("{name}.ssp")),
                resources,
                order: description.order,
            })
        };
        pack().with_context(|| system.display().to_string())
    }

    /// The file that it is written to.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The order of stepping, which a package cannot express.
    pub fn order(&self) -> Order {
        self.order
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
