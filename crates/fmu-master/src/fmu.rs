//! An unpacked FMU: the parts of its model description that the master needs, and its instances.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::ffi::CString;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value::real;
use fmu_description::xml::{self, Element};
use fmu_description::{
    Causality, FmiVersion, LogCategory, ModelDescription, Type, Value, Variable, XmlVariable,
};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::platform::Platform;
use fmu_host::{Instance, Instantiation, InterfaceType, Library, Limits, LoadError, ProcessOwned};
use tempfile::TempDir;

use crate::{Advice, Function, Messages, Sandbox};

/// An FMU for co-simulation or model exchange.
pub struct Fmu {
    /// The file.
    pub path: PathBuf,
    /// Its version of FMI.
    pub version: FmiVersion,
    /// Its variables, in the order of the model description.
    pub variables: Vec<Variable>,
    /// Its scalar variables and the elements of its arrays, which follow each other.
    pub(crate) scalars: Vec<Scalar>,
    /// The indices of variables that depend on clocks.
    clocked: HashSet<usize>,
    /// Outputs, and the inputs that they depend on directly, where the FMU declares it; an array stands for its first
    /// element.
    pub(crate) feedthrough: HashMap<usize, Vec<usize>>,
    /// The indices of scalars by their names and aliases.
    index: HashMap<String, usize>,
    /// The indices of the elements of arrays by their names and aliases.
    arrays: HashMap<String, Range<usize>>,
    units: Units,
    /// The tolerance of its default experiment.
    pub(crate) tolerance: Option<f64>,
    /// The step size of its default experiment (s).
    pub(crate) step: Option<f64>,
    /// How it is run.
    pub(crate) interface_type: InterfaceType,
    /// In FMI 2.0, the number of continuous states and of event indicators.
    pub(crate) equations: [usize; 2],
    code: Code,
    /// Whether a process can have only one instance of the FMU.
    pub(crate) only_once: bool,
    /// The names of the continuous states and their derivatives.
    pub(crate) states: Vec<[String; 2]>,
    /// Whether it provides directional derivatives when it is run in this way.
    pub(crate) is_directional: bool,
}

/// What an instance runs.
enum Code {
    Binary(UnpackedBinary),
    Function(Function),
}

/// An unpacked binary.
struct UnpackedBinary {
    /// The file, relative to the folder.
    file: String,
    /// Loaded by the first instance, and the location of its resources. Must be dropped before the folder, which
    /// removes the file.
    library: OnceLock<Result<(Arc<Library>, String), LoadError>>,
    folder: ProcessOwned<TempDir>,
    token: String,
    limits: Limits,
    /// The log categories of warnings and errors, if it declares those of the standard.
    problems: Vec<CString>,
}

/// A scalar variable, or an element of an array.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scalar {
    /// The index of the variable.
    pub(crate) variable: usize,
    /// Its index in the array.
    pub(crate) element: usize,
}

impl Fmu {
    /// Reads and unpacks a file, with these values of structural parameters, which are the sizes of arrays.
    ///
    /// # Errors
    /// The file is not a valid FMU of FMI 2.0 or 3.0 with this interface and a binary for this machine.
    pub(crate) fn open(
        path: &Path,
        wanted: Option<InterfaceType>,
        sizes: &Sizes,
        sandbox: Sandbox,
    ) -> Result<Self> {
        let read = Self::read(path, wanted, sizes, sandbox);
        read.with_context(|| format!("{} cannot be used", path.display()))
    }

    fn read(
        path: &Path,
        wanted: Option<InterfaceType>,
        sizes: &Sizes,
        sandbox: Sandbox,
    ) -> Result<Self> {
        let mut archive = Archive::open_sound(path)?;
        let text = archive.model_description()?;
        let mut root = xml::parse(&text).with_context(|| MODEL_DESCRIPTION)?;
        resize(&mut root, sizes);
        let model = ModelDescription::read(&root)?;
        let (interface_type, interface) = interface(&model, wanted)?;
        let identifier = interface.attribute("modelIdentifier").unwrap_or_default();
        let binary = binary(&archive, identifier, model.version, sandbox.is_required)?;
        let only_once = interface.is_true("canBeInstantiatedOnlyOncePerProcess");

        let folder = tempfile::Builder::new().prefix("fmu-").tempdir()?;
        archive.unpack("", folder.path()).with_context(|| {
            format!("it cannot be unpacked to the folder {}", folder.path().display())
        })?;
        let indicators = root.attribute("numberOfEventIndicators");
        let indicators = indicators.and_then(|text| text.trim().parse().ok()).unwrap_or(0);
        let count = model.variables().map(|(_, v)| v.element_count());
        let count = count.fold(0_usize, usize::saturating_add);
        ensure!(
            count <= MAX_VARIABLES,
            "its variables have {count} elements, expected at most {MAX_VARIABLES}"
        );
        let mut variables = Vec::new();
        let mut clocked = HashSet::new();
        let mut scalars = Vec::with_capacity(count);
        let mut index = HashMap::with_capacity(count);
        let mut arrays = HashMap::new();
        for (_, v) in model.variables() {
            for name in [v.name.as_str()].into_iter().chain(v.aliases()) {
                let names = (0..v.element_count()).map(|element| v.element_name(name, element));
                index.extend(names.zip(scalars.len()..));
                if !v.dimensions.is_empty() && v.element_count() > 0 {
                    arrays
                        .insert(name.to_owned(), scalars.len()..scalars.len() + v.element_count());
                }
            }
            let variable = variables.len();
            scalars.extend((0..v.element_count()).map(|element| Scalar { variable, element }));
            if v.element.attribute("clocks").is_some() {
                clocked.insert(variable);
            }
            variables.push(Variable::clone(v));
        }
        Ok(Self {
            path: path.to_owned(),
            version: model.version,
            feedthrough: feedthrough(&model),
            variables,
            scalars,
            clocked,
            index,
            arrays,
            units: units(root.list("UnitDefinitions", "Unit"), "BaseUnit"),
            tolerance: model.experiment("tolerance").filter(|t| t.is_finite()),
            step: model.experiment("stepSize").filter(|step| *step > 0.0),
            interface_type,
            equations: [model.derivatives.len(), indicators],
            code: Code::Binary(UnpackedBinary {
                file: binary,
                library: OnceLock::new(),
                folder: ProcessOwned::new(folder),
                token: model.token().to_owned(),
                limits: Limits {
                    call: sandbox.call,
                    memory: sandbox.memory.map(|bytes| bytes.try_into().unwrap_or(usize::MAX)),
                },
                problems: problems(&root),
            }),
            only_once,
            states: states(&model),
            is_directional: interface.is_true(match model.version {
                FmiVersion::Fmi2 => "providesDirectionalDerivative",
                FmiVersion::Fmi3 => "providesDirectionalDerivatives",
            }),
        })
    }

    /// A function with these variables; the path stands for it in messages.
    pub(crate) fn of_function(path: &Path, function: &Function, variables: Vec<Variable>) -> Self {
        let names = variables.iter().map(|variable| variable.name.clone());
        Self {
            path: path.to_owned(),
            version: FmiVersion::Fmi3,
            scalars: (0..variables.len()).map(|variable| Scalar { variable, element: 0 }).collect(),
            index: names.zip(0..).collect(),
            arrays: HashMap::new(),
            variables,
            clocked: HashSet::new(),
            feedthrough: HashMap::new(),
            units: Units::new(),
            tolerance: None,
            step: None,
            interface_type: InterfaceType::CoSimulation,
            equations: [0; 2],
            code: Code::Function(function.clone()),
            only_once: false,
            states: Vec::new(),
            is_directional: false,
        }
    }

    /// Whether it runs as a WebAssembly component.
    pub(crate) fn is_component(&self) -> bool {
        matches!(&self.code, Code::Binary(binary) if binary.file.ends_with(".wasm"))
    }

    /// Whether it must not be called again in this process, because of a fatal error.
    pub(crate) fn is_lost(&self) -> bool {
        let Code::Binary(UnpackedBinary { library, .. }) = &self.code else { return false };
        matches!(library.get(), Some(Ok((library, _))) if library.is_lost())
    }

    /// Its file name.
    pub fn file_name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// The variable of a scalar.
    pub(crate) fn variable(&self, scalar: usize) -> &Variable {
        &self.variables[self.scalars[scalar].variable]
    }

    /// The name of a scalar, with an index if it is an element of an array.
    pub(crate) fn name(&self, scalar: usize) -> String {
        let variable = self.variable(scalar);
        variable.element_name(&variable.name, self.scalars[scalar].element)
    }

    /// The name of a scalar that was found by this name, which may be an alias or the name of its array.
    pub(crate) fn name_as(&self, found: &str, scalar: usize) -> String {
        match self.arrays.contains_key(found) {
            true => self.variable(scalar).element_name(found, self.scalars[scalar].element),
            false => found.to_owned(),
        }
    }

    /// The scalars of the array that a scalar is an element of.
    pub(crate) fn array(&self, scalar: usize) -> Range<usize> {
        let first = self.first(scalar);
        first..first + self.variable(scalar).element_count()
    }

    /// The first of these.
    pub(crate) fn first(&self, scalar: usize) -> usize {
        scalar - self.scalars[scalar].element
    }

    /// The start value of a scalar in the model description.
    pub(crate) fn start(&self, scalar: usize) -> Option<&Value> {
        self.variable(scalar).start_of(self.scalars[scalar].element)
    }

    /// The type whose functions get and set a scalar.
    pub(crate) fn access_type(&self, scalar: usize) -> Type {
        self.variable(scalar).of_type.accessed_as(self.version)
    }

    /// Why the master cannot record a scalar, if so.
    pub(crate) fn unrecordable(&self, scalar: usize) -> Option<&'static str> {
        if self.variable(scalar).of_type == Type::Clock {
            return Some("clocks are not supported");
        }
        let is_clocked = self.clocked.contains(&self.scalars[scalar].variable);
        is_clocked.then_some("clocked variables are not supported")
    }

    /// Why the master can neither connect nor set a scalar, if so.
    pub(crate) fn unusable(&self, scalar: usize) -> Option<&'static str> {
        match self.variable(scalar).of_type {
            Type::Binary => Some("a Binary can only be recorded"),
            _ => self.unrecordable(scalar),
        }
    }

    /// The index of a scalar, if there is one of this name.
    pub(crate) fn get_scalar(&self, name: &str) -> Option<usize> {
        self.index.get(name).copied()
    }

    /// The index of a scalar.
    ///
    /// # Errors
    /// There is no such variable; the error names similar ones.
    pub(crate) fn scalar(&self, name: &str) -> Result<usize> {
        if let Some(index) = self.get_scalar(name) {
            return Ok(index);
        }
        let names = Vec::from_iter((0..self.scalars.len()).map(|scalar| self.name(scalar)));
        let similar = similar(name, names.iter().map(String::as_str));
        let text = format!("{} has no variable {name}; ", self.file_name());
        if let Some(elements) = self.arrays.get(name) {
            let ends = [elements.start, elements.end - 1].map(|scalar| self.name_as(name, scalar));
            bail!("{text}its elements are {} to {}", ends[0], ends[1]);
        }
        match similar.as_slice() {
            [] => Err(Advice::ListVariables(self.file_name()).after(text)),
            names => bail!("{text}did you mean {}?", names.join(" or ")),
        }
    }

    /// The indices of a scalar, or of all elements of an array.
    ///
    /// # Errors
    /// As [`Self::scalar`].
    pub(crate) fn scalars_of(&self, name: &str) -> Result<Range<usize>> {
        match self.arrays.get(name) {
            Some(elements) => Ok(elements.clone()),
            None => self.scalar(name).map(|scalar| scalar..scalar + 1),
        }
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
        let path = self.path.display();
        let what = || format!("component {name}: {path} cannot be instantiated");
        self.try_instantiate(component, name, messages).with_context(what)
    }

    fn try_instantiate(&self, index: usize, name: &str, messages: &Messages) -> Result<Instance> {
        let UnpackedBinary { file, library, folder, token, limits, problems } = match &self.code {
            Code::Binary(binary) => binary,
            Code::Function(function) => {
                return Ok(function.instantiate(name, &self.variables, messages));
            }
        };
        let mut calls = messages.record().calls(index);
        calls.begin(Some(fmu_worker::Function::LOADING));
        let load = || {
            let library = Library::load(&folder.path().join(file), self.version)?;
            let resources = library.location(&folder.path().join("resources"));
            Ok((library, resources))
        };
        let (library, resources) = library.get_or_init(load).as_ref().map_err(Clone::clone)?;
        ensure!(!library.is_lost(), "it is unusable after a fatal error");
        let arguments = Instantiation {
            name,
            interface_type: self.interface_type,
            guid: token,
            resources,
            logging_on: true,
            limits: *limits,
            ..Instantiation::default()
        };
        let (instance, log) = (name.to_owned(), messages.clone());
        let sink = move |logged| log.log(&instance, &logged);
        let function = match (self.version, self.interface_type) {
            (FmiVersion::Fmi2, _) => "fmi2Instantiate",
            (FmiVersion::Fmi3, InterfaceType::CoSimulation) => "fmi3InstantiateCoSimulation",
            (FmiVersion::Fmi3, InterfaceType::ModelExchange) => "fmi3InstantiateModelExchange",
        };
        calls.begin(fmu_worker::Function::named(function));
        let instance = library.instantiate(&arguments, sink)?;
        let mut instance = instance.with_context(|| {
            let reason = messages.reason(function);
            reason.unwrap_or_else(|| "the FMU logged no reason".into())
        })?;
        if messages.only_problems() && !problems.is_empty() {
            calls.begin(fmu_worker::Function::performing(self.version, "set_debug_logging"));
            // An FMU that cannot do so goes on logging everything.
            let _ = instance.set_debug_logging(true, problems);
        }
        Ok(instance)
    }
}

/// The log categories of warnings and errors that an FMU declares (FMI 2.0.5, section 2.2.4). None if it has no category
/// for errors, because it may then log them in any category.
fn problems(root: &Element<'_>) -> Vec<CString> {
    let declared = root.list("LogCategories", "Category").filter_map(|c| c.attribute("name"));
    let of_statuses = declared.filter(|name| name.starts_with("logStatus"));
    let known = |name: &str| {
        let mut known = LogCategory::of_model(true).map(LogCategory::name);
        known.find(|known| known.to_bytes() == name.as_bytes())
    };
    let problems = Vec::from_iter(of_statuses.filter_map(known).map(ToOwned::to_owned));
    if problems.contains(&c"logStatusError".to_owned()) { problems } else { Vec::new() }
}

/// Values of structural parameters by their names.
pub(crate) type Sizes = BTreeMap<String, i128>;

/// Replaces the start values of structural parameters.
fn resize(root: &mut Element<'_>, sizes: &Sizes) {
    let lists = root.children.iter_mut();
    for variable in lists.flat_map(|list| &mut list.children) {
        let size = variable.attribute("name").and_then(|name| sizes.get(name));
        if let Some(size) = size.map(i128::to_string) {
            let starts = variable.attributes.iter_mut();
            for (_, start) in starts.filter(|(key, _)| *key == "start") {
                *start = size.clone().into();
            }
        }
    }
}

/// Maximum number of scalar variables and elements of arrays; more are assumed to be a mistake.
const MAX_VARIABLES: usize = 1 << 20;

/// What an FMU declares, as far as it matters before it is loaded.
pub(crate) struct Declared {
    /// The start time, stop time and step size (s) of its default experiment, if it has them.
    pub(crate) experiment: [Option<f64>; 3],
    /// The units of variables by their names.
    pub(crate) variables: HashMap<String, Option<String>>,
    pub(crate) units: Units,
}

impl Declared {
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = Archive::open_sound(path)?.model_description()?;
        let root = xml::parse(&text).with_context(|| MODEL_DESCRIPTION)?;
        let model = ModelDescription::read(&root)?;
        let named = model.variables().flat_map(|(_, v)| {
            let names = [v.name.as_str()].into_iter().chain(v.aliases());
            names.map(|name| (name.to_owned(), v.unit.clone()))
        });
        Ok(Self {
            experiment: ["startTime", "stopTime", "stepSize"].map(|name| model.experiment(name)),
            variables: named.collect(),
            units: units(root.list("UnitDefinitions", "Unit"), "BaseUnit"),
        })
    }
}

/// How the master runs the FMU, and the element of this interface: as wanted, by default co-simulation if the FMU
/// supports it.
fn interface<'a>(
    model: &ModelDescription<'a>,
    wanted: Option<InterfaceType>,
) -> Result<(InterfaceType, &'a Element<'a>)> {
    let of = |interface_type| {
        let element = match interface_type {
            InterfaceType::CoSimulation => model.co_simulation(),
            InterfaceType::ModelExchange => model.model_exchange(),
        };
        Some((interface_type, element?))
    };
    let all = [InterfaceType::CoSimulation, InterfaceType::ModelExchange];
    let tried = match &wanted {
        Some(wanted) => std::slice::from_ref(wanted),
        None => &all,
    };
    let Some(found) = tried.iter().find_map(|interface| of(*interface)) else {
        let other = match (all.into_iter().find(|i| of(*i).is_some()), model.scheduled_execution())
        {
            (Some(other), _) => format!(", only {}", other.as_str()),
            (None, Some(_)) => {
                ", only scheduled execution, whose model partitions a host must activate by clocks"
                    .to_owned()
            }
            (None, None) => String::new(),
        };
        let wanted = wanted.unwrap_or_default().as_str();
        bail!("it does not support {wanted}{other}");
    };
    let is_input_clock =
        |v: &&XmlVariable<'_>| v.of_type == Type::Clock && v.causality == Causality::Input;
    if let Some((_, clock)) = model.variables().find(|(_, v)| is_input_clock(v)) {
        bail!(
            "its clock {} must be ticked by the master, which is not supported; it needs a host that activates input clocks in event mode",
            clock.name
        );
    }
    Ok(found)
}

/// The binary for this machine, or the WebAssembly component if there is none, or if it is `required`.
fn binary(
    archive: &Archive,
    identifier: &str,
    version: FmiVersion,
    required: bool,
) -> Result<String> {
    let native = Platform::of_this_machine(version);
    let component = Platform::component(version);
    for platform in [native.filter(|_| !required), component].into_iter().flatten() {
        let binary = platform.binary(identifier);
        // The names in an archive are safe, but the binary must also be in the folder of the platform.
        if archive.names.contains(&binary) && !identifier.contains(['/', '\\']) {
            return Ok(binary);
        }
    }
    ensure!(!required, "it has no WebAssembly component, and native binaries were refused");
    let platform = native
        .with_context(|| format!("FMI {} does not define this platform", version.as_str()))?;
    let other = archive.names.iter().find(|name| {
        let file = Path::new(name).file_stem().unwrap_or_default();
        file.to_str().is_some_and(|file| **name == platform.binary(file))
    });
    match other {
        Some(other) => bail!(
            "its binary {other} is not named after the model identifier {identifier:?}, expected {}",
            platform.binary(identifier)
        ),
        None => bail!("it has no binary for this machine ({})", platform.folder),
    }
}

/// The names of the continuous states and their derivatives.
fn states(model: &ModelDescription<'_>) -> Vec<[String; 2]> {
    let names = model.derivatives.iter().filter_map(|unknown| {
        let derivative = model.variable(unknown.index)?;
        let state = model.referred(derivative.value, "derivative")?;
        Some([state.name.clone(), derivative.name.clone()])
    });
    names.collect()
}

fn feedthrough(model: &ModelDescription<'_>) -> HashMap<usize, Vec<usize>> {
    // Invalid variables are left out.
    let mut first = 0;
    let mut positions: HashMap<usize, usize> = HashMap::new();
    for (index, variable) in model.variables() {
        positions.insert(index, first);
        first += variable.element_count();
    }
    let position = |index: usize| positions.get(&index).copied();
    let declared = model.outputs.iter().filter_map(|unknown| {
        let inputs = unknown.dependencies.as_ref()?.iter();
        let inputs = inputs.filter_map(|n| model.index(*n).and_then(position));
        Some((unknown.index.and_then(position)?, inputs.collect()))
    });
    declared.collect()
}

/// The definitions of units by their names.
pub(crate) type Units = HashMap<String, Vec<(String, f64)>>;

/// The definitions of units in base units: exponents, factor and offset that differ from the default.
pub(crate) fn units<'a>(units: impl Iterator<Item = &'a Element<'a>>, base: &str) -> Units {
    units
        .filter_map(|unit| {
            let base = unit.child(base)?;
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

/// The known names most similar to an unknown one, or that end with it, as `pid.kp` does with `kp`.
pub(crate) fn similar<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    const MIN_SIMILARITY: f64 = 0.85;
    let mut scored: Vec<(f64, &str)> = known
        .map(|known| match known.strip_suffix(name) {
            Some(rest) if rest.ends_with('.') => (1.0, known),
            _ => (strsim::jaro_winkler(name, known), known),
        })
        .filter(|(score, _)| *score >= MIN_SIMILARITY)
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.into_iter().take(3).map(|(_, known)| known).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_categories_of_problems_are_known_if_errors_have_one() {
        let found = |names: &[&'static str]| {
            let category = |name: &&'static str| Element::new("Category").with("name", *name);
            let categories = names.iter().map(category);
            problems(&Element::new("root").listing("LogCategories", categories.collect()))
        };
        let standard = found(&["logStatusWarning", "logEvents", "logStatusError", "logAll"]);
        assert_eq!(standard, [c"logStatusWarning".to_owned(), c"logStatusError".to_owned()]);
        assert!(found(&["logStatusWarning", "error"]).is_empty());
        assert!(found(&[]).is_empty());
    }
}
