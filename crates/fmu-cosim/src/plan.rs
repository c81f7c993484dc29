//! A loaded and checked system, ready to simulate.

use std::collections::{BTreeMap, HashMap};
use std::fmt;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, VariableType};

use crate::system::{Link, Planned, Port, planned, port, start};
use crate::value::Typed;
use crate::wiring::Wiring;
use crate::{Description, Experiment, Order, Value, Variable, check};

/// A system with loaded FMUs and checked connections, start values and recorded variables.
pub struct Plan {
    pub(crate) components: Vec<Planned>,
    pub(crate) order: Order,
    pub(crate) experiment: Experiment,
    pub(crate) wiring: Wiring,
    columns: Vec<Column>,
}

/// A recorded variable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// `component.variable`
    pub name: String,
    /// Its unit; 1 for a Real without unit, empty for other variables.
    pub unit: String,
    /// Its type.
    pub kind: VariableType,
}

impl Column {
    /// A value of a row as the variable has it: `true`, `3` or `0.5`.
    pub fn show(&self, value: f64) -> impl fmt::Display + use<> {
        Shown(self.kind, value)
    }
}

/// A value as a variable of a type has it.
pub(crate) struct Shown(pub(crate) VariableType, pub(crate) f64);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(kind, value) = *self;
        match kind {
            VariableType::Boolean if value == 0.0 => f.write_str("false"),
            VariableType::Boolean if value == 1.0 => f.write_str("true"),
            // The digits of its own precision.
            VariableType::Float32 => write!(f, "{:?}", value as f32),
            kind if kind.is_float() => write!(f, "{value:?}"),
            _ => write!(f, "{value}"),
        }
    }
}

/// A start value that fits its variable.
#[derive(Debug, Clone)]
pub struct Start {
    port: Port,
    value: Typed,
}

impl Plan {
    /// Loads the FMUs of a system, each file once, and checks that everything fits.
    ///
    /// # Errors
    /// Something does not fit; the error names it: a file, a variable, a causality, a type, a unit, a
    /// start value, the times, an algebraic loop.
    pub fn new(description: &Description) -> Result<Self> {
        let mut fmus = HashMap::new();
        description.experiment().steps()?;
        tolerance("tolerance", description.tolerance)?;
        ensure!(
            !description.components.is_empty(),
            "the system has no component"
        );
        let mut components: Vec<Planned> = Vec::new();
        for component in &description.components {
            let name = &component.name;
            ensure!(
                !name.is_empty() && !name.contains(|c: char| c == '.' || c.is_control()),
                "the component name {name:?} is invalid; expected a name without dots and control characters"
            );
            ensure!(
                components.iter().all(|other| other.name != *name),
                "two components have the name {name}"
            );
            tolerance(&format!("tolerance of {name}"), component.tolerance)?;
            let new = planned(component, description.tolerance, &mut fmus)?;
            if let Some(other) = components.iter().find(|c| c.fmu.path == new.fmu.path) {
                ensure!(
                    !new.fmu.only_once,
                    "{} allows only one instance; {} and {name} both use it",
                    new.fmu.file_name(),
                    other.name
                );
            }
            components.push(new);
        }
        let links = description
            .connections
            .iter()
            .map(|connection| {
                Ok(Link {
                    from: port(&components, &connection.from)?,
                    to: port(&components, &connection.to)?,
                    scale: connection.scale,
                })
            })
            .collect::<Result<Vec<_>>>()?;
        check::links(&components, &links)?;
        if description.order == Order::Sequential && !description.allow_algebraic_loops {
            check::algebraic_loops(&components, &links)?;
        }
        let recorded = recorded(&components, &description.outputs)?;
        Ok(Self {
            order: description.order,
            experiment: description.experiment(),
            wiring: Wiring::new(&components, &links, &recorded),
            columns: recorded
                .iter()
                .map(|port| column(&components, *port))
                .collect(),
            components,
        })
    }

    /// The components, in their order.
    pub fn components(&self) -> &[Planned] {
        &self.components
    }

    /// The names of the components and of their files, for [`Recorder::failure`](crate::Recorder).
    pub fn names(&self) -> Vec<(String, String)> {
        let components = self.components.iter();
        components
            .map(|c| (c.name.clone(), c.fmu.file_name()))
            .collect()
    }

    /// The recorded variables, in the order of a row.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The column of a recorded variable.
    ///
    /// # Errors
    /// It is not recorded.
    pub fn column(&self, name: &str) -> Result<usize> {
        self.columns
            .iter()
            .position(|column| column.name == name)
            .with_context(|| format!("{name} is not recorded"))
    }

    /// The times of a run.
    pub fn experiment(&self) -> Experiment {
        self.experiment
    }

    /// A start value for `component.variable` that replaces the one of the description.
    ///
    /// # Errors
    /// There is no such variable, or the value has the wrong type.
    pub fn start(&self, name: &str, value: &Value) -> Result<Start> {
        let port = port(&self.components, name)?;
        let variable = port.of(&self.components);
        ensure!(
            !variable.is_structural,
            "{name} = {value} cannot be set for single runs, as it is the size of arrays; expected it in the start values of the system"
        );
        let value = start(variable, name, value)?;
        Ok(Start { port, value })
    }

    /// Whether a variable, `component.variable`, is a structural parameter.
    pub fn is_structural(&self, name: &str) -> bool {
        port(&self.components, name).is_ok_and(|port| port.of(&self.components).is_structural)
    }

    /// The start values of a component by the indices of its variables: those of the description, unless
    /// `others` replace them.
    pub(crate) fn starts<'a>(
        &'a self,
        component: usize,
        others: &'a [Start],
    ) -> BTreeMap<usize, &'a Typed> {
        let planned = &self.components[component];
        let mut starts: BTreeMap<usize, &Typed> = planned
            .starts
            .iter()
            .map(|(index, value)| (*index, value))
            .collect();
        let others = others
            .iter()
            .filter(|start| start.port.component == component);
        starts.extend(others.map(|start| (start.port.variable, &start.value)));
        starts
    }

    /// Checks that arrays of which elements are set can be set as a whole.
    ///
    /// # Errors
    /// An element is not set, and the FMU has no start value for it, as its description is that of a
    /// smaller array.
    pub(crate) fn check_arrays(
        &self,
        component: usize,
        starts: &BTreeMap<usize, &Typed>,
    ) -> Result<()> {
        let planned = &self.components[component];
        let variables = &planned.fmu.variables;
        for index in starts.keys() {
            let (element, count) = (variables[*index].element, variables[*index].count);
            let mut array = index - element..index - element + count;
            let is_missing = |i: &usize| variables[*i].start.is_none() && !starts.contains_key(i);
            if count > 1
                && let Some(missing) = array.find(is_missing)
            {
                bail!(
                    "{} cannot be set without {}, for which the FMU has no start value",
                    planned.name_of(*index),
                    planned.name_of(missing)
                );
            }
        }
        Ok(())
    }

    /// The end of the last step: the stop time, or one step later if there are sampled components,
    /// whose last row is that of a step from the stop time.
    pub fn end(&self) -> f64 {
        let Experiment { stop, step, .. } = self.experiment;
        match self.steps_from_stop() {
            true => stop + step,
            false => stop,
        }
    }

    /// Whether a step from the stop time is needed, because a recorded component is sampled.
    pub(crate) fn steps_from_stop(&self) -> bool {
        self.wiring.records_after_step()
    }
}

/// Checks a tolerance, which `key` names.
fn tolerance(key: &str, tolerance: Option<f64>) -> Result<()> {
    match tolerance {
        Some(value) if !(value > 0.0 && value.is_finite()) => {
            bail!("{key} = {value} is invalid, expected a positive number")
        }
        _ => Ok(()),
    }
}

fn recorded(components: &[Planned], names: &[String]) -> Result<Vec<Port>> {
    if names.is_empty() {
        let all = components
            .iter()
            .enumerate()
            .flat_map(|(component, planned)| {
                let outputs =
                    planned.fmu.variables.iter().enumerate().filter(|(_, v)| {
                        v.causality == Causality::Output && unrecordable(v).is_none()
                    });
                outputs.map(move |(variable, _)| Port {
                    component,
                    variable,
                })
            });
        return Ok(all.collect());
    }
    let mut ports = Vec::new();
    for name in names {
        let port = port(components, name)?;
        if let Some(reason) = unrecordable(port.of(components)) {
            bail!("{name} cannot be recorded: {reason}");
        }
        ensure!(!ports.contains(&port), "{name} is recorded twice");
        ports.push(port);
    }
    Ok(ports)
}

/// Why a variable cannot be recorded, if so.
fn unrecordable(variable: &Variable) -> Option<&'static str> {
    match variable.kind {
        VariableType::String => Some("it is a String"),
        _ => variable.unsupported,
    }
}

fn column(components: &[Planned], port: Port) -> Column {
    let variable = port.of(components);
    let none = match variable.kind.is_float() {
        true => "1",
        false => "",
    };
    Column {
        name: components[port.component].name_of(port.variable),
        unit: variable.unit.clone().unwrap_or_else(|| none.into()),
        kind: variable.kind,
    }
}
