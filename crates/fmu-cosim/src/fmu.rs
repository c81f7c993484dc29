//! An unpacked FMU: the parts of its model description that the master needs, and its instances.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use anyhow::{Context, Result, anyhow, bail, ensure};
use fmu_description::value::real;
use fmu_description::xml::{self, Element};
use fmu_description::{
    Capability, Causality, Initial, ModelDescription, ScalarVariable, Variability, VariableType,
};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::platform::Platform;
use fmu_host::{Instance, Instantiation, Library, LoadError};
use tempfile::TempDir;

use crate::Messages;
use crate::recorder::Function;

/// An FMU for co-simulation.
pub struct Fmu {
    /// The file.
    pub path: PathBuf,
    /// Its variables, in the order of the model description.
    pub variables: Vec<Variable>,
    /// Outputs, and the inputs that they depend on directly; `None` where the FMU declares nothing.
    pub(crate) feedthrough: Vec<(usize, Option<Vec<usize>>)>,
    index: HashMap<String, usize>,
    units: HashMap<String, Vec<(String, f64)>>,
    guid: String,
    /// The tolerance of its default experiment.
    pub(crate) tolerance: Option<f64>,
    /// The binary, relative to the folder.
    binary: String,
    /// Loaded by the first instance. Must be dropped before the folder, which removes the file.
    library: OnceLock<Result<Arc<Library>, LoadError>>,
    folder: TempDir,
    /// Whether a process can have only one instance of the FMU.
    pub(crate) only_once: bool,
}

/// The owned parts of a [`ScalarVariable`] that the master needs once the document is dropped.
#[derive(Debug, Clone)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// Its value reference.
    pub reference: u32,
    /// Its type.
    pub kind: VariableType,
    /// Its causality.
    pub causality: Causality,
    /// Its variability.
    pub variability: Variability,
    /// How it is initialized.
    pub initial: Option<Initial>,
    /// Its unit.
    pub unit: Option<String>,
    /// The name of its type, if the FMU declares one.
    pub declared_type: Option<String>,
    /// Names and values of the items if it is an Enumeration.
    pub items: Vec<(String, i32)>,
}

impl Fmu {
    /// Reads and unpacks a file.
    ///
    /// # Errors
    /// The file is not a valid FMI 2.0 co-simulation FMU with a binary for this machine.
    pub fn open(path: &Path) -> Result<Self> {
        Self::read(path).with_context(|| format!("{} cannot be used", path.display()))
    }

    fn read(path: &Path) -> Result<Self> {
        let mut archive = Archive::open_sound(path)?;
        let text = archive.model_description()?;
        let root = xml::parse(&text).with_context(|| MODEL_DESCRIPTION)?;
        let model = ModelDescription::read(&root)?;
        let slave = model
            .co_simulation()
            .context("it does not support co-simulation")?;
        let identifier = slave.attribute("modelIdentifier").unwrap_or_default();
        let binary = binary(&archive, identifier)?;
        let only_once = Capability::CanBeInstantiatedOnlyOncePerProcess.is_claimed_by(slave);

        let folder = tempfile::Builder::new().prefix("fmu-").tempdir()?;
        archive.unpack("", folder.path())?;
        let variables: Vec<_> = model.variables().map(|(_, v)| variable(v)).collect();
        let index = variables
            .iter()
            .enumerate()
            .map(|(i, v)| (v.name.clone(), i))
            .collect();
        Ok(Self {
            path: path.to_owned(),
            feedthrough: feedthrough(&model),
            variables,
            index,
            units: units(&root),
            guid: root.attribute("guid").unwrap_or_default().to_owned(),
            tolerance: model.experiment("tolerance").filter(|t| t.is_finite()),
            binary,
            library: OnceLock::new(),
            folder,
            only_once,
        })
    }

    /// Its file name.
    pub fn file_name(&self) -> String {
        self.path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    }

    /// The index of a variable.
    ///
    /// # Errors
    /// There is no such variable; the error names similar ones.
    pub(crate) fn find(&self, name: &str) -> Result<usize> {
        if let Some(&index) = self.index.get(name) {
            return Ok(index);
        }
        let names = || self.variables.iter().map(|v| v.name.as_str());
        let is_element =
            |other: &&str| other.strip_prefix(name).is_some_and(|i| i.starts_with('['));
        let elements: Vec<_> = names().filter(is_element).collect();
        let similar = similar(name, names());
        let hint = match (elements.as_slice(), similar.as_slice()) {
            ([first, .., last], _) => format!("; its elements are {first} to {last}"),
            (_, []) => String::new(),
            (_, names) => format!("; did you mean {}?", names.join(" or ")),
        };
        bail!("{} has no variable {name}{hint}", self.file_name())
    }

    /// The definition of a unit in base units, if the FMU has one: exponents, factor and offset by name,
    /// without default values.
    pub fn unit(&self, name: &str) -> Option<&[(String, f64)]> {
        self.units.get(name).map(Vec::as_slice)
    }

    /// Whether a unit of this FMU equals one of another FMU, by name or by definition in base
    /// units.
    pub(crate) fn same_unit(&self, unit: &str, other: &Self, of_other: &str) -> bool {
        unit == of_other
            || matches!(
                (self.unit(unit), other.unit(of_other)),
                (Some(a), Some(b)) if a == b
            )
    }

    /// Creates an instance that logs to the messages of its simulation.
    ///
    /// # Errors
    /// The binary cannot be loaded or the FMU returns an error; its message is included.
    pub(crate) fn instantiate(
        &self,
        component: usize,
        name: &str,
        messages: &Messages,
    ) -> Result<Instance> {
        self.try_instantiate(component, name, messages)
            .map_err(|reason| {
                let path = self.path.display();
                anyhow!("component {name}: {path} cannot be instantiated: {reason}")
            })
    }

    fn try_instantiate(
        &self,
        component: usize,
        name: &str,
        messages: &Messages,
    ) -> Result<Instance, String> {
        messages.recorder().begin(component, Function::Load);
        let library = self
            .library
            .get_or_init(|| Library::load(&self.folder.path().join(&self.binary)))
            .as_ref()
            .map_err(ToString::to_string)?;
        if library.is_lost() {
            return Err("it is unusable after a fatal error".into());
        }
        let arguments = Instantiation {
            name,
            kind: fmu_host::Kind::CoSimulation,
            guid: &self.guid,
            resources: &fmu_host::uri(&self.folder.path().join("resources")),
            logging_on: true,
        };
        let (instance, log) = (name.to_owned(), messages.clone());
        messages.recorder().begin(component, Function::Instantiate);
        library
            .instantiate(&arguments, move |logged| log.log(&instance, &logged))
            .map_err(|failure| failure.to_string())?
            .ok_or_else(|| {
                let reason = messages.reason("fmi2Instantiate");
                reason.unwrap_or_else(|| "the FMU logged no reason".into())
            })
    }
}

fn binary(archive: &Archive, identifier: &str) -> Result<String> {
    let platform = Platform::of_this_machine().context("FMI 2.0 does not define this platform")?;
    let binary = platform.binary(identifier);
    // The names in an archive are safe, but the binary must also be in the folder of the platform.
    ensure!(
        archive.names.contains(&binary) && !identifier.contains(['/', '\\']),
        "it has no binary for this machine ({})",
        platform.folder
    );
    Ok(binary)
}

/// Copies the parts of a variable that the master needs.
fn variable(v: &ScalarVariable<'_>) -> Variable {
    Variable {
        name: v.name.to_owned(),
        reference: v.reference,
        kind: v.kind,
        causality: v.causality,
        variability: v.variability,
        initial: v.initial,
        unit: v.unit().map(str::to_owned),
        declared_type: v.value.attribute("declaredType").map(str::to_owned),
        items: v
            .items()
            .map(|(name, value)| (name.to_owned(), value))
            .collect(),
    }
}

fn feedthrough(model: &ModelDescription<'_>) -> Vec<(usize, Option<Vec<usize>>)> {
    // Invalid variables are left out.
    let positions: HashMap<usize, usize> = (model.variables().enumerate())
        .map(|(position, (index, _))| (index, position))
        .collect();
    let position = |index: usize| positions.get(&index).copied();
    model
        .outputs
        .iter()
        .filter_map(|unknown| {
            let inputs = unknown.dependencies.as_ref();
            let known = |all: &Vec<u32>| all.iter().filter_map(|i| position(*i as usize)).collect();
            Some((position(unknown.index)?, inputs.map(known)))
        })
        .collect()
}

/// The definitions of units in base units: exponents, factor and offset that differ from the default.
fn units(root: &Element<'_>) -> HashMap<String, Vec<(String, f64)>> {
    root.list("UnitDefinitions", "Unit")
        .filter_map(|unit| {
            let base = unit.child("BaseUnit")?;
            let mut parts: Vec<(String, f64)> = base
                .attributes
                .iter()
                .filter_map(|(name, value)| Some(((*name).to_owned(), real(value)?)))
                .filter(|(name, value)| *value != if name == "factor" { 1.0 } else { 0.0 })
                .collect();
            parts.sort_by(|a, b| a.0.cmp(&b.0));
            Some((unit.attribute("name")?.to_owned(), parts))
        })
        .collect()
}

/// The known names most similar to an unknown one.
pub(crate) fn similar<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    const MIN_SIMILARITY: f64 = 0.85;
    let mut scored: Vec<(f64, &str)> = known
        .map(|known| (strsim::jaro_winkler(name, known), known))
        .filter(|(score, _)| *score >= MIN_SIMILARITY)
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.into_iter().take(3).map(|(_, known)| known).collect()
}
