//! The interface of an exported model, as it is read from its binary.

use std::collections::{BTreeMap, HashMap};

use anyhow::{Result, bail};
use serde::Deserialize;

use crate::references::first_sample_clock;
use crate::variable::{ExportInfo, Variable};
use crate::{Causality, ClockType, InterfaceType, IntervalVariability, Naming, Type, Variability};

/// The interface of a model, read from its binary; see [`read_interfaces`](crate::read_interfaces). The copy in
/// a binary has its fields in this order.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
pub struct ExportedModel {
    /// Name of the model and its `modelIdentifier`: a C identifier.
    pub name: String,
    /// Description of the model.
    pub description: String,
    /// Whether it has a sample time.
    pub is_sampled: bool,
    /// Whether it is described by differential or algebraic equations, which a host can solve.
    pub is_continuous: bool,
    /// Whether it has a log of its own.
    pub has_log: bool,
    /// The names and descriptions of the log categories that it declares.
    pub log_categories: Vec<(String, String)>,
    /// Whether its state cannot be saved.
    pub is_unsaved: bool,
    /// Whether a process can have one instance only.
    pub is_single_instance: bool,
    /// Whether its state cannot be serialized.
    pub is_unserialized: bool,
    /// How the names of variables are written.
    pub naming: Naming,
    /// Stop time and step size of the default experiment (s), which starts at 0.
    pub default_experiment: (f64, f64),
    /// Relative tolerance of its integrator; 0 if it has none.
    pub tolerance: f64,
    /// The variables, in the order of the fields.
    pub variables: Vec<Variable>,
    /// Value reference of the independent variable of FMI 3.0.
    pub time: usize,
    /// GUID of the interface.
    pub guid: String,
    /// Whether it acts only at the ticks of its clocks. It is part of the supplement of a copy.
    #[serde(skip)]
    pub is_clocked: bool,
    /// Whether its samples are model partitions with clocks of their own, so that it is for scheduled execution only. It
    /// is part of the supplement of a copy.
    #[serde(skip)]
    pub has_sample_clocks: bool,
    /// Whether it simulates a bus, for the manifest of FMI-LS-BUS.
    #[serde(skip)]
    pub is_bus_simulation: bool,
    /// Start time of the default experiment (s). It is no part of the copy in a binary, as those below.
    #[serde(skip)]
    pub start_time: f64,
    /// Whether all communication steps have the step size of the default experiment, or are multiples of it.
    #[serde(skip)]
    pub has_fixed_step: bool,
    /// The definitions of units that FMUs define, in base units: exponents, factor and offset; none if it is unknown.
    #[serde(skip)]
    pub units: BTreeMap<String, Vec<(String, f64)>>,
    /// The interface types to export; if there are none, all that the model has.
    #[serde(skip)]
    pub interface_types: Vec<InterfaceType>,
}

/// What a copy in a binary has before its model, if that has clocks or what else the format of other copies lacks.
#[derive(Debug, Deserialize)]
pub(crate) struct Supplement {
    /// See [`ExportedModel::is_clocked`].
    is_clocked: bool,
    /// See [`ExportedModel::is_bus_simulation`].
    is_bus_simulation: bool,
    /// See [`Interface::sample_clocks`](crate::Interface::sample_clocks).
    sample_clocks: Vec<String>,
    variables: Vec<SupplementedVariable>,
}

/// The fields of a [`Variable`] with these names.
#[derive(Debug, Deserialize)]
struct SupplementedVariable {
    reference: u32,
    clocks: Vec<u32>,
    max_size: Option<usize>,
    clock: Option<ClockType>,
    network: Option<(String, String)>,
}

impl ExportedModel {
    /// Adds the supplement of its copy.
    pub(crate) fn supplement(&mut self, supplement: Supplement) {
        (self.is_clocked, self.is_bus_simulation) =
            (supplement.is_clocked, supplement.is_bus_simulation);
        for SupplementedVariable { reference, clocks, max_size, clock, network } in
            supplement.variables
        {
            let found = self.variables.iter_mut().find(|v| v.reference == reference);
            if let Some(variable) = found {
                (variable.clocks, variable.max_size, variable.clock) = (clocks, max_size, clock);
                variable.exported.network = network;
            }
        }
        if !supplement.sample_clocks.is_empty() {
            self.add_sample_clocks(&supplement.sample_clocks);
        }
    }

    /// Adds the clocks of its samples. If there is only one, it is the clock of all that a sample reads and computes; of
    /// several, any may compute an output. The one that co-simulation takes first has the highest priority.
    fn add_sample_clocks(&mut self, names: &[String]) {
        (self.is_clocked, self.has_sample_clocks) = (true, true);
        let ends = self.variables.iter().map(|v| v.reference as usize + v.element_count());
        let first = first_sample_clock(self.time, ends.max().unwrap_or_default()) as u32;
        for v in &mut self.variables {
            let changes = matches!(v.variability, Variability::Continuous | Variability::Discrete);
            if changes && v.causality != Causality::Independent {
                v.variability = Variability::Discrete;
                v.clocks.extend((names.len() == 1).then_some(first));
            }
        }
        self.variables.extend(names.iter().zip(first..).zip(0..).map(
            |((name, reference), priority)| Variable {
                name: name.clone(),
                reference,
                description: format!(
                    "Activates the sample{}",
                    match names.len() {
                        1 => String::new(),
                        _ => format!(" of the rate {name}"),
                    }
                ),
                causality: Causality::Input,
                variability: Variability::Discrete,
                of_type: Type::Clock,
                clock: Some(ClockType {
                    interval_variability: IntervalVariability::Calculated,
                    priority: Some(priority),
                    ..ClockType::default()
                }),
                exported: ExportInfo { nominal: 1.0, ..ExportInfo::default() },
                ..Variable::default()
            },
        ));
    }

    /// Writes the names of the variables, which are structured, in the naming convention of the model.
    ///
    /// # Errors
    /// Two variables, or elements of arrays, get the same name.
    pub(crate) fn write_names(&mut self) -> Result<()> {
        if self.naming == Naming::Structured {
            return Ok(());
        }
        let mut known = HashMap::new();
        let scalars = self.scalars();
        let names = scalars
            .flat_map(|(_, v, element)| v.names().map(move |name| v.element_name(name, element)));
        for structured in names {
            let written = self.naming.write(structured.clone());
            if let Some(other) = known.insert(written.clone(), structured.clone()) {
                bail!(
                    "{other} and {structured} of {} both become {written} with naming = \"{}\"; expected other names",
                    self.name,
                    self.naming.as_str()
                );
            }
        }
        for v in &mut self.variables {
            for name in [&mut v.name].into_iter().chain(&mut v.aliases) {
                *name = self.naming.write(std::mem::take(name));
            }
            v.exported.naming = self.naming;
        }
        Ok(())
    }

    /// The scalar variables: their value references, their variables, and their elements.
    pub fn scalars(&self) -> impl Iterator<Item = (usize, &Variable, usize)> {
        (self.variables.iter())
            .flat_map(|v| (0..v.element_count()).map(move |element| (v, element)))
            .map(|(v, element)| (v.reference as usize + element, v, element))
    }

    /// The number of elements of a variable that are in use by default: the start value of its
    /// structural parameter.
    pub fn elements_in_use(&self, v: &Variable) -> usize {
        let is_size = |other: &&Variable| Some(other.reference as usize) == v.exported.size;
        let start = (self.variables.iter().find(is_size)).and_then(|size| size.start.first());
        let size = start.and_then(|size| usize::try_from(size.as_whole()?).ok());
        size.map_or(v.element_count(), |size| size.min(v.element_count()))
    }

    /// Whether it has events: samples, ticks of clocks, or those of its equations. A host can then solve it by model
    /// exchange.
    pub fn has_events(&self) -> bool {
        self.is_continuous || self.is_sampled || self.is_clocked
    }

    /// Whether it has clocks.
    pub fn has_clocks(&self) -> bool {
        self.variables.iter().any(|v| v.of_type == Type::Clock)
    }

    /// Whether it is exported for model exchange.
    pub fn is_for_model_exchange(&self) -> bool {
        self.has_events()
            && !self.has_sample_clocks
            && self.may_be_for(InterfaceType::ModelExchange)
    }

    /// Whether it is exported for co-simulation.
    pub fn is_for_co_simulation(&self) -> bool {
        !self.has_sample_clocks && self.may_be_for(InterfaceType::CoSimulation)
    }

    /// Whether it is exported for scheduled execution.
    pub fn is_for_scheduled_execution(&self) -> bool {
        self.is_clocked && self.may_be_for(InterfaceType::ScheduledExecution)
    }

    /// Whether it is exported for an interface type.
    pub fn is_for(&self, interface_type: InterfaceType) -> bool {
        match interface_type {
            InterfaceType::CoSimulation => self.is_for_co_simulation(),
            InterfaceType::ModelExchange => self.is_for_model_exchange(),
            InterfaceType::ScheduledExecution => self.is_for_scheduled_execution(),
        }
    }

    /// Whether an interface type is exported if the model has it.
    fn may_be_for(&self, interface_type: InterfaceType) -> bool {
        self.interface_types.is_empty() || self.interface_types.contains(&interface_type)
    }

    /// Whether the derivatives of all that a host integrates are known: of the state derivatives and
    /// the continuous outputs.
    pub(crate) fn has_all_derivatives(&self) -> bool {
        let is_unknown =
            |v: &&Variable| v.is_derivative() || v.is_continuous_output() && !v.is_state();
        let mut unknowns = self.variables.iter().filter(is_unknown).peekable();
        self.is_continuous
            && unknowns.peek().is_some()
            && unknowns.all(|v| !v.exported.depends_on.is_empty())
    }

    /// Order of the time derivatives of outputs that the FMU provides: the derivatives of states are
    /// known. Hosts may ask for the derivatives of every output that is a real number, also of a discrete one.
    pub(crate) fn max_output_derivative_order(&self) -> u32 {
        let is_real = |v: &&Variable| v.is_output() && v.of_type.is_float();
        let outputs = self.variables.iter().filter(is_real);
        let mut outputs = outputs.peekable();
        let is_known = outputs.peek().is_some() && outputs.all(Variable::is_state);
        u32::from(self.is_continuous && is_known)
    }
}
