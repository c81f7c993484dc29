//! A system, loaded and checked: runs are made of it.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, Variability, VariableType};

use crate::fmu::similar;
use crate::transfer::Group;
use crate::value::Typed;
use crate::{Component, Description, Experiment, Fmu, Order, Simulation, Value, Variable, check};

/// A system whose FMUs are loaded, and whose connections, start values and records are known to fit.
pub struct Plan {
    pub(crate) components: Vec<Planned>,
    pub(crate) order: Order,
    pub(crate) experiment: Experiment,
    /// What feeds the inputs of each component.
    pub(crate) wires: Vec<Vec<Wire>>,
    pub(crate) records: Vec<Record>,
    columns: Vec<Column>,
}

/// A component whose FMU is loaded.
pub struct Planned {
    /// Its name in the system.
    pub name: String,
    /// Its FMU, which components of the same file share.
    pub fmu: Arc<Fmu>,
    pub(crate) sampled: bool,
    starts: Vec<(usize, Typed)>,
}

/// A variable of a component, by their indices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Port {
    pub(crate) component: usize,
    pub(crate) variable: usize,
}

/// A connection, resolved.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Link {
    pub(crate) from: Port,
    pub(crate) to: Port,
}

/// The inputs of one component and type, and the outputs that feed them, in the same order.
pub(crate) struct Wire {
    pub(crate) kind: VariableType,
    pub(crate) outputs: Vec<Group>,
    pub(crate) inputs: Group,
}

/// Variables of one component and type that are recorded, and their columns.
pub(crate) struct Record {
    pub(crate) kind: VariableType,
    pub(crate) group: Group,
    pub(crate) columns: Vec<usize>,
}

/// A recorded variable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// `component.variable`
    pub name: String,
    /// Its unit; 1 if it has none.
    pub unit: String,
}

/// A start value that fits its variable.
#[derive(Debug, Clone)]
pub struct Start {
    port: Port,
    value: Typed,
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

impl Plan {
    /// Loads the FMUs of a system, each file once, and checks that everything fits.
    ///
    /// # Errors
    /// What does not fit, by name: a file, a variable, a causality, a type, a unit, a start value, the
    /// times, an algebraic loop.
    pub fn new(description: &Description) -> Result<Self> {
        let mut fmus = HashMap::new();
        description.experiment().steps()?;
        ensure!(
            !description.components.is_empty(),
            "the system has no component"
        );
        let mut components: Vec<Planned> = Vec::new();
        for component in &description.components {
            let name = &component.name;
            ensure!(
                !name.is_empty() && !name.contains(|c: char| c == '.' || c.is_control()),
                "the component name {name:?} is refused; expected a text without dots and control characters"
            );
            ensure!(
                components.iter().all(|other| other.name != *name),
                "two components have the name {name}"
            );
            let new = planned(component, &mut fmus)?;
            if let Some(other) = components.iter().find(|c| c.fmu.path == new.fmu.path) {
                ensure!(
                    !new.fmu.only_once,
                    "{} can have one instance only; {} and {name} are two",
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
                })
            })
            .collect::<Result<Vec<_>>>()?;
        check::links(&components, &links)?;
        if description.order == Order::Sequential {
            check::algebraic_loops(&components, &links)?;
        }
        let recorded = recorded(&components, &description.outputs)?;
        Ok(Self {
            order: description.order,
            experiment: description.experiment(),
            wires: wires(&components, &links),
            records: records(&components, &recorded),
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

    /// A start value for `component.variable`, in place of that of the description.
    ///
    /// # Errors
    /// There is no such variable, or the value does not fit it.
    pub fn start(&self, name: &str, value: &Value) -> Result<Start> {
        let port = port(&self.components, name)?;
        let value = start(port.of(&self.components), name, value)?;
        Ok(Start { port, value })
    }

    /// Makes and initializes the instances of a run, with these start values in place of those of the
    /// description.
    ///
    /// # Errors
    /// An FMU refuses; with its message.
    pub fn simulate(&self, starts: &[Start]) -> Result<Simulation<'_>> {
        Simulation::new(self, starts)
    }

    /// The start values of a component: those of the description, then others.
    pub(crate) fn starts<'a>(
        &'a self,
        component: usize,
        others: &'a [Start],
    ) -> impl Iterator<Item = (&'a Variable, &'a Typed)> {
        let others = others
            .iter()
            .filter(move |start| start.port.component == component)
            .map(|start| (start.port.of(&self.components), &start.value));
        self.components[component].starts().chain(others)
    }
}

fn planned(component: &Component, fmus: &mut HashMap<PathBuf, Arc<Fmu>>) -> Result<Planned> {
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

/// Whether all outputs are discrete, as those of a sampled controller.
fn is_sampled(fmu: &Fmu) -> bool {
    let mut outputs = fmu
        .variables
        .iter()
        .filter(|v| v.causality == Causality::Output)
        .peekable();
    outputs.peek().is_some() && outputs.all(|v| v.variability == Variability::Discrete)
}

fn start(variable: &Variable, name: &str, value: &Value) -> Result<Typed> {
    match variable.causality {
        Causality::Input | Causality::Parameter => value.typed(variable, name),
        _ => bail!("{name} = {value} is refused: only inputs and parameters have start values"),
    }
}

/// Finds `component.variable`.
fn port(components: &[Planned], name: &str) -> Result<Port> {
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
                None => format!("there are {}", names.join(", ")),
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

fn recorded(components: &[Planned], names: &[String]) -> Result<Vec<Port>> {
    if names.is_empty() {
        let all = components
            .iter()
            .enumerate()
            .flat_map(|(component, planned)| {
                let outputs = planned.fmu.variables.iter().enumerate().filter(|(_, v)| {
                    v.causality == Causality::Output && v.kind != VariableType::String
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
        ensure!(
            port.of(components).kind != VariableType::String,
            "{name} is a String, which cannot be recorded"
        );
        ensure!(!ports.contains(&port), "{name} is recorded twice");
        ports.push(port);
    }
    Ok(ports)
}

fn column(components: &[Planned], port: Port) -> Column {
    Column {
        name: components[port.component].name_of(port.variable),
        unit: port
            .of(components)
            .unit
            .clone()
            .unwrap_or_else(|| "1".into()),
    }
}

/// The types that have functions of their own: an Enumeration is an Integer there.
pub(crate) fn channel(kind: VariableType) -> VariableType {
    match kind {
        VariableType::Enumeration => VariableType::Integer,
        other => other,
    }
}

const CHANNELS: [VariableType; 3] = [
    VariableType::Real,
    VariableType::Integer,
    VariableType::Boolean,
];

/// Groups the connections by the component that they feed, the type, and the component they come from.
fn wires(components: &[Planned], links: &[Link]) -> Vec<Vec<Wire>> {
    let of_component = |fed: usize| {
        let of_kind = |kind: VariableType| {
            let mut groups: BTreeMap<usize, (Group, Group)> = BTreeMap::new();
            for link in links.iter().filter(|link| {
                link.to.component == fed && channel(link.to.of(components).kind) == kind
            }) {
                let (outputs, inputs) = groups.entry(link.from.component).or_default();
                push(outputs, components, link.from);
                push(inputs, components, link.to);
            }
            let mut all = Group {
                component: fed,
                ..Group::default()
            };
            let mut outputs = Vec::new();
            for (group, inputs) in groups.into_values() {
                outputs.push(group);
                all.references.extend(inputs.references);
                all.names.extend(inputs.names);
            }
            (!outputs.is_empty()).then_some(Wire {
                kind,
                outputs,
                inputs: all,
            })
        };
        CHANNELS.into_iter().filter_map(of_kind).collect()
    };
    (0..components.len()).map(of_component).collect()
}

/// Groups the recorded variables by component and type.
fn records(components: &[Planned], ports: &[Port]) -> Vec<Record> {
    let mut records = Vec::new();
    for component in 0..components.len() {
        for kind in CHANNELS {
            let mut record = Record {
                kind,
                group: Group::default(),
                columns: Vec::new(),
            };
            for (column, port) in ports.iter().enumerate() {
                if port.component == component && channel(port.of(components).kind) == kind {
                    push(&mut record.group, components, *port);
                    record.columns.push(column);
                }
            }
            if !record.columns.is_empty() {
                records.push(record);
            }
        }
    }
    records
}

fn push(group: &mut Group, components: &[Planned], port: Port) {
    let variable = port.of(components);
    group.component = port.component;
    group.references.push(variable.reference);
    group.names.push(variable.name.clone());
}
