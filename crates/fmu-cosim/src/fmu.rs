//! An FMU file, unpacked: what the master needs of its description, and instances.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, anyhow, bail, ensure};
use fmi::fmi2::binding::Fmi2Binding;
use fmi::fmi2::import::Fmi2Import;
use fmi::fmi2::instance::InstanceCS;
use fmi::traits::FmiImport;
use fmu_description::value::real;
use fmu_description::xml::{self, Element};
use fmu_description::{
    Capability, Causality, ModelDescription, ScalarVariable, Variability, VariableType,
};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::platform::Platform;
use quick_xml::escape::escape;

use crate::guard::{self, guarded};
use crate::messages;

/// An FMU for co-simulation.
pub struct Fmu {
    /// The file.
    pub path: PathBuf,
    /// Its variables, in the order of the model description.
    pub variables: Vec<Variable>,
    /// Outputs, and the inputs that they depend on directly; `None` where the FMU does not say.
    pub(crate) feedthrough: Vec<(usize, Option<Vec<usize>>)>,
    index: HashMap<String, usize>,
    units: HashMap<String, Vec<(String, f64)>>,
    /// Keeps the binary loaded between instances, each of which loads it for itself: else that of a
    /// run after another would be mapped into memory anew. Before `import`, which removes the file.
    loaded: OnceLock<Option<Fmi2Binding>>,
    import: Fmi2Import,
    lost: AtomicBool,
    /// Whether the FMU says that one process can have one instance of it only.
    pub(crate) only_once: bool,
}

/// A variable of an FMU.
#[derive(Debug, Clone)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// Its value reference.
    pub reference: u32,
    /// Its type.
    pub kind: VariableType,
    /// Who gives it its value.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// Its unit.
    pub unit: Option<String>,
    /// The name of its type, if the FMU declares one.
    pub declared_type: Option<String>,
    /// Names and numbers of the items, of an Enumeration.
    pub items: Vec<(String, i32)>,
}

impl Fmu {
    /// Reads and unpacks a file.
    ///
    /// # Errors
    /// It is not a sound FMU for co-simulation by FMI 2.0 with a binary for this machine.
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
            .context("it is not for co-simulation")?;
        let identifier = slave.attribute("modelIdentifier").unwrap_or_default();
        check_identifier(identifier)?;
        check_binary(&archive, identifier)?;
        let only_once = Capability::CanBeInstantiatedOnlyOncePerProcess.is_claimed_by(slave);

        let folder = tempfile::Builder::new().prefix("fmu-").tempdir()?;
        archive.unpack("", folder.path())?;
        let guid = root.attribute("guid").unwrap_or_default();
        let import = Fmi2Import::new(folder, &reduced(identifier, guid))
            .map_err(|error| anyhow!("{MODEL_DESCRIPTION}: {error}"))?;

        let variables: Vec<_> = model.variables().map(|(_, v)| variable(v)).collect();
        let index = variables
            .iter()
            .enumerate()
            .map(|(i, v)| (v.name.clone(), i))
            .collect();
        messages::collect();
        guard::silence();
        Ok(Self {
            path: path.to_owned(),
            feedthrough: feedthrough(&model),
            variables,
            index,
            units: units(&root),
            loaded: OnceLock::new(),
            import,
            lost: AtomicBool::new(false),
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
    /// There is none; names those that are most similar.
    pub(crate) fn find(&self, name: &str) -> Result<usize> {
        if let Some(&index) = self.index.get(name) {
            return Ok(index);
        }
        let similar = similar(name, self.variables.iter().map(|v| v.name.as_str()));
        let hint = match similar.as_slice() {
            [] => String::new(),
            names => format!("; did you mean {}?", names.join(" or ")),
        };
        bail!("{} has no variable {name}{hint}", self.file_name())
    }

    /// What a unit is in base units, if the FMU says so: exponents, factor and offset by name, without
    /// those that have their default.
    pub fn unit(&self, name: &str) -> Option<&[(String, f64)]> {
        self.units.get(name).map(Vec::as_slice)
    }

    /// Whether two units, of this and of another FMU, are the same: by name, or by what they are
    /// in base units.
    pub(crate) fn same_unit(&self, unit: &str, other: &Self, of_other: &str) -> bool {
        unit == of_other
            || matches!(
                (self.unit(unit), other.unit(of_other)),
                (Some(a), Some(b)) if a == b
            )
    }

    /// Makes an instance.
    ///
    /// # Errors
    /// The binary cannot be loaded, or the FMU refuses; with its message.
    pub(crate) fn instantiate(&self, name: &str) -> Result<InstanceCS> {
        let cannot = |reason: String| {
            let path = self.path.display();
            anyhow!("component {name}: {path} cannot be instantiated: {reason}")
        };
        if self.is_lost() {
            return Err(cannot("a fatal error has broken it".into()));
        }
        messages::begin_call();
        match guarded(|| InstanceCS::new(&self.import, name, false, true)) {
            Ok(Ok(slave)) => {
                self.loaded.get_or_init(|| {
                    let slave = self.import.model_description().co_simulation.as_ref()?;
                    self.import.binding(&slave.model_identifier).ok()
                });
                Ok(slave)
            }
            Ok(Err(error)) => Err(cannot(messages::reason("fmi2Instantiate").unwrap_or_else(
                || match error {
                    fmi::Error::Instantiation => "the FMU logged no reason".into(),
                    error => error.to_string(),
                },
            ))),
            Err(outcome) => Err(cannot(format!("fmi2Instantiate {outcome}"))),
        }
    }

    /// Gives the FMU up after a fatal error, which corrupts all of its instances: by the standard
    /// nothing of it is called again, not even to free them.
    pub(crate) fn lose(&self) {
        self.lost.store(true, Ordering::Relaxed);
    }

    /// Whether the FMU was given up.
    pub(crate) fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }
}

/// The part of a model description that the crate `fmi` needs. It refuses some valid ones as a whole,
/// such as those with annotations of a tool.
fn reduced(identifier: &str, guid: &str) -> String {
    format!(
        r#"<fmiModelDescription fmiVersion="2.0" modelName="{identifier}" guid="{}"><CoSimulation modelIdentifier="{identifier}"/><ModelVariables/><ModelStructure/></fmiModelDescription>"#,
        escape(guid)
    )
}

/// It becomes part of a path.
fn check_identifier(identifier: &str) -> Result<()> {
    ensure!(
        !identifier.is_empty()
            && identifier
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || c == '_'),
        "the model identifier {identifier:?} is not a C identifier"
    );
    Ok(())
}

fn check_binary(archive: &Archive, identifier: &str) -> Result<()> {
    let platform = Platform::of_this_machine().context("FMI 2.0 does not know this platform")?;
    ensure!(
        archive.names.contains(&platform.binary(identifier)),
        "it has no binary for this machine ({})",
        platform.folder
    );
    Ok(())
}

/// What the master keeps of a variable when the document is dropped.
fn variable(v: &ScalarVariable<'_>) -> Variable {
    Variable {
        name: v.name.to_owned(),
        reference: v.reference,
        kind: v.kind,
        causality: v.causality,
        variability: v.variability,
        unit: v.unit().map(str::to_owned),
        declared_type: v.value.attribute("declaredType").map(str::to_owned),
        items: v
            .items()
            .map(|(name, value)| (name.to_owned(), value))
            .collect(),
    }
}

fn feedthrough(model: &ModelDescription<'_>) -> Vec<(usize, Option<Vec<usize>>)> {
    let zero_based = |index: u32| (index as usize).checked_sub(1);
    model
        .outputs
        .iter()
        .filter_map(|unknown| {
            let inputs = unknown.dependencies.as_ref();
            let inputs = inputs.map(|all| all.iter().copied().filter_map(zero_based).collect());
            Some((unknown.index.checked_sub(1)?, inputs))
        })
        .collect()
}

/// What units are in base units: exponents, factor and offset that are not the default.
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

/// The names that are most similar to one that is unknown.
pub(crate) fn similar<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    const ENOUGH: f64 = 0.85;
    let mut scored: Vec<(f64, &str)> = known
        .map(|known| (strsim::jaro_winkler(name, known), known))
        .filter(|(score, _)| *score >= ENOUGH)
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.into_iter().take(3).map(|(_, known)| known).collect()
}
