//! The components of a system with their FMUs, and the resolution of names.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use fmu_description::{Causality, Initial, Variability};

use crate::fmu::similar;
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

pub(crate) fn planned(
    component: &Component,
    tolerance: Option<f64>,
    fmus: &mut HashMap<PathBuf, Arc<Fmu>>,
) -> Result<Planned> {
    let fmu =
        open(&component.fmu, fmus).with_context(|| format!("component {}", component.name))?;
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

fn open(path: &Path, fmus: &mut HashMap<PathBuf, Arc<Fmu>>) -> Result<Arc<Fmu>> {
    if let Some(fmu) = fmus.get(path) {
        return Ok(fmu.clone());
    }
    let fmu = Arc::new(Fmu::open(path)?);
    fmus.insert(path.to_owned(), fmu.clone());
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
