//! The components of a system with their FMUs, and the resolution of names.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use fmu_description::{Causality, Initial, Variability};

use crate::fmu::{Sizes, similar};
use crate::value::Typed;
use crate::{Component, Fmu, Scale, Value, Variable};

/// A component whose FMU is loaded.
pub struct Planned {
    /// Its name in the system.
    pub name: String,
    /// Its FMU, shared by components with the same file.
    pub fmu: Arc<Fmu>,
    pub(crate) sampled: bool,
    /// The relative tolerance of its solver.
    pub(crate) tolerance: Option<f64>,
    pub(crate) starts: Vec<(usize, Typed)>,
}

/// A variable of a component, by their indices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Port {
    pub(crate) component: usize,
    pub(crate) variable: usize,
}

/// A resolved connection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Link {
    pub(crate) from: Port,
    pub(crate) to: Port,
    pub(crate) scale: Option<Scale>,
}

impl Port {
    pub(crate) fn of(self, components: &[Planned]) -> &Variable {
        &components[self.component].fmu.variables[self.variable]
    }
}

impl Planned {
    /// The name of a variable in the system.
    pub(crate) fn name_of(&self, variable: usize) -> String {
        format!("{}.{}", self.name, self.fmu.variables[variable].name)
    }

    /// The start values of the description.
    pub fn starts(&self) -> impl Iterator<Item = (&Variable, &Typed)> {
        let starts = self.starts.iter();
        starts.map(|(variable, value)| (&self.fmu.variables[*variable], value))
    }
}

/// The opened FMUs by their files and sizes.
pub(crate) type Fmus = HashMap<(PathBuf, Sizes), Arc<Fmu>>;

pub(crate) fn planned(
    component: &Component,
    tolerance: Option<f64>,
    fmus: &mut Fmus,
) -> Result<Planned> {
    let mut open = |sizes| {
        open(&component.fmu, sizes, fmus).with_context(|| format!("component {}", component.name))
    };
    let mut fmu = open(Sizes::new())?;
    let sizes = sizes(component, &fmu)?;
    if !sizes.is_empty() {
        fmu = open(sizes)?;
    }
    let starts = component
        .start
        .iter()
        .map(|(name, value)| {
            let full = format!("{}.{name}", component.name);
            let index = fmu.find(name).with_context(|| full.clone())?;
            Ok((index, start(&fmu.variables[index], &full, value)?))
        })
        .collect::<Result<_>>()?;
    Ok(Planned {
        name: component.name.clone(),
        sampled: component.sampled.unwrap_or_else(|| is_sampled(&fmu)),
        tolerance: component.tolerance.or(tolerance).or(fmu.tolerance),
        starts,
        fmu,
    })
}

/// The values of structural parameters that the description gives.
fn sizes(component: &Component, fmu: &Fmu) -> Result<Sizes> {
    let mut sizes = Sizes::new();
    for (name, value) in &component.start {
        // Names of other elements may exist only with these sizes.
        let Some(variable) = fmu.find(name).ok().map(|index| &fmu.variables[index]) else {
            continue;
        };
        if variable.is_structural
            && let Typed::Integer(size) =
                start(variable, &format!("{}.{name}", component.name), value)?
        {
            sizes.insert(name.clone(), size);
        }
    }
    Ok(sizes)
}

fn open(path: &Path, sizes: Sizes, fmus: &mut Fmus) -> Result<Arc<Fmu>> {
    let key = (path.to_owned(), sizes);
    if let Some(fmu) = fmus.get(&key) {
        return Ok(fmu.clone());
    }
    let fmu = Arc::new(Fmu::open_sized(path, &key.1)?);
    fmus.insert(key, fmu.clone());
    Ok(fmu)
}

/// Whether all outputs are discrete, like those of a sampled controller.
fn is_sampled(fmu: &Fmu) -> bool {
    let mut outputs = fmu
        .variables
        .iter()
        .filter(|v| v.causality == Causality::Output)
        .peekable();
    outputs.peek().is_some() && outputs.all(|v| v.variability == Variability::Discrete)
}

pub(crate) fn start(variable: &Variable, name: &str, value: &Value) -> Result<Typed> {
    if let Some(reason) = variable.unsupported {
        bail!("{name} = {value} cannot be set: {reason}");
    }
    let is_set_by_causality = matches!(variable.causality, Causality::Input | Causality::Parameter);
    let has_start = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
    let is_constant = variable.variability == Variability::Constant;
    if is_set_by_causality || (has_start && !is_constant) {
        return value.typed(variable, name);
    }
    bail!(
        "{name} = {value} cannot be set: only inputs, parameters, and variables with initial exact or approx have start values"
    )
}

/// Finds `component.variable`.
pub(crate) fn port(components: &[Planned], name: &str) -> Result<Port> {
    let (component, variable) = name
        .split_once('.')
        .with_context(|| format!("{name:?} is not of the form component.variable"))?;
    let index = components
        .iter()
        .position(|c| c.name == component)
        .with_context(|| {
            let names: Vec<&str> = components.iter().map(|c| c.name.as_str()).collect();
            let known = match similar(component, names.iter().copied()).first() {
                Some(name) => format!("did you mean {name}?"),
                None => format!("the components are {}", names.join(", ")),
            };
            format!("{name}: there is no component {component:?}; {known}")
        })?;
    let variable = components[index]
        .fmu
        .find(variable)
        .with_context(|| name.to_owned())?;
    Ok(Port {
        component: index,
        variable,
    })
}
