//! Opens an FMU: reads its model description, chooses how to run it, and unpacks it.

use std::collections::HashMap;
use std::path::Path;
use std::sync::OnceLock;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml::{self, Element};
use fmu_description::{
    Causality, FmiVersion, ModelDescription, Type, Variability, Variable, XmlVariable,
};
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_host::{InterfaceType, Limits};

use super::files::FmuFiles;
use super::{Fmu, JacobianStructure, Saves, Scalar, Sizes};
use crate::code::{Code, UnpackedBinary, find_binary, problem_categories};
use crate::declarations::units;
use crate::similar::with_similar_file;
use crate::{Advice, Compilation, Sandbox};

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
        compilation: &Compilation,
    ) -> Result<Self> {
        let read = Self::read(path, wanted, sizes, sandbox, compilation);
        let read = read.map_err(|error| with_similar_file(error, path));
        read.with_context(|| format!("{} cannot be used", path.display()))
    }

    fn read(
        path: &Path,
        wanted: Option<InterfaceType>,
        sizes: &Sizes,
        sandbox: Sandbox,
        compilation: &Compilation,
    ) -> Result<Self> {
        let mut files = FmuFiles::open(path)?;
        let text = files.model_description()?;
        let mut root = xml::parse(&text).with_context(|| MODEL_DESCRIPTION)?;
        resize(&mut root, sizes);
        let model = ModelDescription::read(&root)?;
        let (interface_type, interface) = interface(&model, wanted)?;
        let identifier = interface.attribute("modelIdentifier").unwrap_or_default();
        let found = find_binary(&files.names(), identifier, model.version, sandbox.is_required)?;
        let binary = match (&found, compilation.is_wanted) {
            (Some(binary), _) => binary.clone(),
            (None, is_wanted) => {
                let platform = fmu_compile::platform(model.version)?;
                if !is_wanted {
                    let folder = platform.folder;
                    let text =
                        format!("it has no binary for this machine ({folder}), but sources; ");
                    return Err(Advice::Compile.after(text));
                }
                platform.binary(identifier)
            }
        };
        let only_once = interface.is_true("canBeInstantiatedOnlyOncePerProcess");

        let folder = files.unpack()?;
        let compiled = match found {
            Some(_) => None,
            None => Some(compilation.add(path, &binary, folder.path())?),
        };
        let indicators = root.attribute("numberOfEventIndicators");
        let indicators = indicators.and_then(|text| text.trim().parse().ok()).unwrap_or(0);
        let count = model.variables().map(|(_, v)| v.element_count());
        let count = count.fold(0_usize, usize::saturating_add);
        ensure!(
            count <= MAX_VARIABLES,
            "its variables have {count} elements, expected at most {MAX_VARIABLES}"
        );
        let mut variables = Vec::new();
        let mut nominals = HashMap::new();
        let mut scalars = Vec::with_capacity(count);
        let mut index = HashMap::with_capacity(count);
        let mut arrays = HashMap::new();
        for (_, v) in model.variables() {
            for name in v.names() {
                let names = (0..v.element_count()).map(|element| v.element_name(name, element));
                index.extend(names.zip(scalars.len()..));
                if !v.dimensions.is_empty() && v.element_count() > 0 {
                    arrays
                        .insert(name.to_owned(), scalars.len()..scalars.len() + v.element_count());
                }
            }
            let variable = variables.len();
            scalars.extend((0..v.element_count()).map(|element| Scalar { variable, element }));
            let nominal = v.inherited("nominal").and_then(|text| text.trim().parse().ok());
            let nominal = nominal.map(f64::abs).filter(|n| n.is_finite() && *n > 0.0);
            nominals.extend(nominal.map(|nominal| (variable, nominal)));
            variables.push(Variable::clone(v));
        }
        Ok(Self {
            path: path.to_owned(),
            version: model.version,
            feedthrough: feedthrough(&model),
            settable: match model.version {
                FmiVersion::Fmi2 => settable_aliases(&variables),
                FmiVersion::Fmi3 => HashMap::new(),
            },
            scalars,
            nominals,
            index,
            arrays,
            units: units(root.list("UnitDefinitions", "Unit"), "BaseUnit"),
            tolerance: model.experiment("tolerance").filter(|t| t.is_finite()),
            step: model.experiment("stepSize").filter(|step| *step > 0.0),
            interface_type,
            equations: [model.derivatives.len(), indicators],
            code: Code::Binary(UnpackedBinary {
                version: model.version,
                interface_type,
                file: binary,
                library: OnceLock::new(),
                observed: OnceLock::new(),
                folder,
                token: model.token().to_owned(),
                limits: Limits {
                    call: sandbox.call,
                    memory: sandbox.memory.map(|bytes| bytes.try_into().unwrap_or(usize::MAX)),
                },
                problems: problem_categories(&root),
                compiled,
            }),
            only_once,
            has_event_mode: interface_type == InterfaceType::CoSimulation
                && interface.is_true("hasEventMode"),
            has_clocks: interface_type != InterfaceType::ModelExchange
                && variables.iter().any(|v| {
                    let is_of_host = matches!(v.causality, Causality::Input | Causality::Output);
                    v.of_type == Type::Clock && is_of_host
                }),
            may_return_early: interface.is_true("mightReturnEarlyFromDoStep"),
            evaluates_discrete_states: interface.is_true("providesEvaluateDiscreteStates"),
            variables,
            output_derivatives: output_derivatives(interface),
            interpolates_inputs: interface.is_true("canInterpolateInputs"),
            states: states(&model),
            jacobian: JacobianStructure::of(&model),
            is_directional: interface.is_true(match model.version {
                FmiVersion::Fmi2 => "providesDirectionalDerivative",
                FmiVersion::Fmi3 => "providesDirectionalDerivatives",
            }),
            saves: match model.version {
                FmiVersion::Fmi2 => Saves {
                    in_memory: interface.is_true("canGetAndSetFMUstate"),
                    in_file: interface.is_true("canSerializeFMUstate"),
                },
                FmiVersion::Fmi3 => Saves {
                    in_memory: interface.is_true("canGetAndSetFMUState"),
                    in_file: interface.is_true("canSerializeFMUState"),
                },
            },
        })
    }
}

/// The scalars of FMI 2.0 that are set through another one: of all with the same value reference, at most one is set from
/// outside or has a start value (FMI 2.0.5, section 2.2.7).
fn settable_aliases(scalars: &[Variable]) -> HashMap<usize, usize> {
    let value = |v: &Variable| (v.of_type.accessed_as(FmiVersion::Fmi2), v.reference);
    let is_settable =
        |(v, _): &(&Variable, usize)| !v.start.is_empty() && v.variability != Variability::Constant;
    let all = || scalars.iter().zip(0..);
    let settable = all().filter(is_settable);
    let settable: HashMap<_, usize> = settable.map(|(v, scalar)| (value(v), scalar)).collect();
    let others = all().filter(|scalar| !is_settable(scalar));
    others.filter_map(|(v, scalar)| Some((scalar, *settable.get(&value(v))?))).collect()
}

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
            InterfaceType::ScheduledExecution => model.scheduled_execution(),
        };
        Some((interface_type, element?))
    };
    let all = [
        InterfaceType::CoSimulation,
        InterfaceType::ModelExchange,
        InterfaceType::ScheduledExecution,
    ];
    let tried = match &wanted {
        Some(wanted) => std::slice::from_ref(wanted),
        None => &all,
    };
    let Some(found) = tried.iter().find_map(|interface| of(*interface)) else {
        let other = match all.into_iter().find(|i| of(*i).is_some()) {
            Some(other) => format!(", only {}", other.as_str()),
            None => String::new(),
        };
        let wanted = wanted.unwrap_or_default().as_str();
        bail!("it does not support {wanted}{other}");
    };
    let is_input_clock =
        |v: &&XmlVariable<'_>| v.of_type == Type::Clock && v.causality == Causality::Input;
    let is_clocked = match found.0 {
        InterfaceType::CoSimulation => found.1.is_true("hasEventMode"),
        InterfaceType::ModelExchange => false,
        InterfaceType::ScheduledExecution => true,
    };
    if let (Some((_, clock)), false) =
        (model.variables().find(|(_, v)| is_input_clock(v)), is_clocked)
    {
        bail!(
            "its clock {} ticks in event mode, which it does not have in {}; expected co-simulation with hasEventMode",
            clock.name,
            found.0.as_str()
        );
    }
    Ok(found)
}

/// The highest order of the derivatives of outputs. Model exchange has none.
fn output_derivatives(interface: &Element<'_>) -> usize {
    /// More are not useful, as inputs are extrapolated over short times.
    const HIGHEST: usize = 8;
    let order = interface.attribute("maxOutputDerivativeOrder");
    order.and_then(|text| text.trim().parse().ok()).unwrap_or(0).min(HIGHEST)
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
