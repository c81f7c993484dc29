//! The interface of a container: its variables, and where their values are in the system.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

use anyhow::{Result, ensure};
use fmu_description::hash::Hash;
use fmu_description::words::is_identifier;
use fmu_description::{
    Causality, DeclaredType, ExportInfo, ExportedModel, FmiVersion, Initial, Naming, Type, Unit,
    Value, Variability, Variable,
};

use super::choice;
use crate::components::ScalarId;
use crate::simulation::Row;
use crate::{Description, Fmu, Place, Plan};

/// The variables of a container. The value reference of a variable is its index.
pub struct Interface {
    pub(super) exposed: Vec<Exposed>,
    /// The definitions of units in base units.
    units: BTreeMap<String, Vec<(String, f64)>>,
    /// Why the state cannot be saved, if so.
    pub(super) unsavable: Option<String>,
    is_single_instance: bool,
    guid: String,
}

/// A variable of a container.
pub(super) struct Exposed {
    pub(super) variable: Variable,
    pub(super) id: ScalarId,
    pub(super) source: Source,
}

/// Where the value of a variable is.
#[derive(Clone, Copy)]
pub(super) enum Source {
    /// An input, in the store of the system.
    Input(Place),
    /// A recorded variable, in the row of the system.
    Output(Place),
    /// A parameter, which the container remembers.
    Parameter,
}

impl Interface {
    /// The variables that a system exposes: inputs, outputs, parameters.
    ///
    /// # Errors
    /// A variable is unknown or cannot be exposed, or two have the same name.
    pub fn new(description: &Description, plan: &Plan) -> Result<Self> {
        let names = &description.expose.names;
        let components = &plan.components;
        let inputs = plan.host_inputs.iter().zip(&plan.wiring.host_places);
        let inputs = inputs.map(|(id, place)| (*id, Source::Input(*place), None));
        let parameters = choice::parameters(&description.expose, components, plan.input.as_ref())?;
        let is_set: HashSet<_> = plan.host_inputs.iter().chain(&parameters).copied().collect();
        let columns = plan.columns.iter().zip(Row::places(&plan.columns));
        let outputs = plan.recorded.iter().zip(columns);
        let outputs = outputs
            .filter(|(id, _)| !is_set.contains(id))
            .map(|(id, (column, place))| (*id, Source::Output(place), Some(column.name.clone())));
        let parameters = parameters.iter().map(|id| (*id, Source::Parameter, None));
        let (mut exposed, mut known) = (Vec::new(), HashMap::new());
        let mut types = Types::default();
        let mut unused: HashSet<&String> = names.keys().collect();
        for (id, source, column) in inputs.chain(outputs).chain(parameters) {
            let in_system = column.unwrap_or_else(|| id.name(components));
            let name = names.get(&in_system).unwrap_or(&in_system).clone();
            unused.remove(&in_system);
            ensure!(
                !name.is_empty() && !name.contains(char::is_control),
                "expose.names: {in_system} = {name:?}, expected a name without control characters"
            );
            if let Some(other) = known.insert(name.clone(), in_system.clone()) {
                anyhow::bail!(
                    "{other} and {in_system} both have the name {name} in the container; expected different names in expose.names"
                );
            }
            let mut variable = variable(plan, id, source);
            variable.declared_type = types.of(&components[id.component].name, &variable);
            (variable.name, variable.reference) = (name, exposed.len() as u32);
            exposed.push(Exposed { variable, id, source });
        }
        ensure!(
            unused.is_empty(),
            "expose.names: {} is not exposed",
            Vec::from_iter(unused.iter().map(|name| name.as_str())).join(", ")
        );
        let state = |reason: fn(&Fmu) -> Option<&'static str>| {
            let mut all = components.iter();
            all.find_map(|c| {
                Some(format!("{} ({}): {}", c.name, c.fmu.file_name(), reason(&c.fmu)?))
            })
        };
        let mut interface = Self {
            units: units(plan, &exposed),
            unsavable: state(Fmu::unsavable),
            is_single_instance: components.iter().any(|component| component.fmu.only_once),
            guid: String::new(),
            exposed,
        };
        interface.guid = interface.hash(plan.experiment.step);
        Ok(interface)
    }

    /// A hash of the interface.
    pub fn guid(&self) -> &str {
        &self.guid
    }

    /// A hash of all that a host sees of the variables, and of the step (s).
    fn hash(&self, step: f64) -> String {
        let mut hash = Hash::new().bytes(&step.to_bits().to_le_bytes());
        for Exposed { variable: v, .. } in &self.exposed {
            let bounds = [&v.min, &v.max].map(|bound| bound.as_ref().map(Value::to_string));
            let start = v.start.iter().map(Value::to_string).collect::<Vec<_>>().join(" ");
            let texts = [
                &*v.name,
                v.of_type.as_str(),
                v.causality.as_str(),
                v.variability.as_str(),
                v.unit.as_deref().unwrap_or_default(),
                bounds[0].as_deref().unwrap_or_default(),
                bounds[1].as_deref().unwrap_or_default(),
                &start,
            ];
            hash = texts.iter().fold(hash, |hash, text| hash.bytes(text.as_bytes()).bytes(&[0xff]));
        }
        let digits = format!("{:032x}", hash.0);
        let parts = [0..8, 8..12, 12..16, 16..20, 20..32].map(|part| &digits[part]);
        format!("{{{}}}", parts.join("-"))
    }

    /// The model that the XML describes.
    pub(super) fn model(&self, name: &str, description: &Description) -> ExportedModel {
        let Description { start, stop, step, .. } = *description;
        let mut variables: Vec<Variable> =
            self.exposed.iter().map(|exposed| exposed.variable.clone()).collect();
        let is_structured = |name: &str| {
            let name = name.split('[').next().unwrap_or_default();
            name.split('.').all(is_identifier)
        };
        let naming = match variables.iter().all(|v| is_structured(&v.name)) {
            true => Naming::Structured,
            false => Naming::Flat,
        };
        variables.iter_mut().for_each(|v| v.exported.naming = Naming::Structured);
        let of_components = description.components.iter().map(|component| &*component.name);
        let components = Vec::from_iter(of_components).join(", ");
        ExportedModel {
            name: name.to_owned(),
            description: format!("System of {components}"),
            has_log: true,
            is_unsaved: self.unsavable.is_some(),
            // States are kept in memory.
            is_unserialized: true,
            is_single_instance: self.is_single_instance,
            naming,
            default_experiment: (stop, step),
            start_time: start,
            has_fixed_step: true,
            time: variables.len(),
            variables,
            guid: self.guid.clone(),
            units: self.units.clone(),
            ..ExportedModel::default()
        }
    }

    /// The variables that a version of FMI cannot express, and why.
    pub(super) fn left_out(model: &ExportedModel, version: FmiVersion) -> Vec<String> {
        let left_out = model.inexpressible(version).into_iter();
        left_out.map(|(variable, reason)| format!("{} is {reason}", variable.name)).collect()
    }
}

/// The variable of a container for a scalar of the system, still without its name.
fn variable(plan: &Plan, id: ScalarId, source: Source) -> Variable {
    let of_fmu = id.variable(&plan.components);
    let causality = match (source, of_fmu.causality) {
        (Source::Input(_), _) => Causality::Input,
        (Source::Parameter, _) => Causality::Parameter,
        (Source::Output(_), Causality::Output) => Causality::Output,
        (Source::Output(_), _) => Causality::Local,
    };
    let is_constant = of_fmu.variability == Variability::Constant;
    let has_start = !matches!(source, Source::Output(_)) || is_constant;
    let start = has_start.then(|| start(plan, id)).flatten();
    // A local value follows the input or parameter that it is in the FMU.
    let variability = match (causality, of_fmu.variability) {
        (Causality::Local, Variability::Fixed) => Variability::Fixed,
        (_, variability) => variability,
    };
    let unit = of_fmu.unit.clone().filter(|unit| !unit.is_empty());
    let display = of_fmu.display_unit.clone().filter(|display| {
        let [unit, display] = [unit.as_deref().unwrap_or_default(), display].map(Unit::parse);
        unit.is_ok_and(|unit| display.is_ok_and(|display| unit.conversion_to(&display).is_some()))
    });
    Variable {
        description: of_fmu.description.clone(),
        causality,
        variability,
        initial: match (source, is_constant) {
            (Source::Input(_), _) => None,
            (Source::Output(_), false) => Some(Initial::Calculated),
            _ => Some(Initial::Exact),
        },
        exported: ExportInfo { nominal: 1.0, ..ExportInfo::default() },
        // Whether a clock has ticked.
        of_type: if of_fmu.of_type == Type::Clock { Type::Boolean } else { of_fmu.of_type },
        unit,
        display_unit: display,
        mime_type: of_fmu.mime_type.clone(),
        min: of_fmu.min.clone(),
        max: of_fmu.max.clone(),
        start: start.into_iter().collect(),
        declared_type: of_fmu.declared_type.clone(),
        ..Variable::default()
    }
}

/// The start value of a scalar in the system, or in the FMU.
pub(super) fn start(plan: &Plan, id: ScalarId) -> Option<Value> {
    let component = &plan.components[id.component];
    let in_system = component.starts.iter().rev().find(|(scalar, _)| *scalar == id.scalar);
    in_system.map(|(_, value)| value).or_else(|| component.fmu.start(id.scalar)).cloned()
}

/// The enumerations of a container, in which different ones have different names.
#[derive(Default)]
struct Types(HashMap<String, Arc<DeclaredType>>);

impl Types {
    /// The type of a variable of a component.
    fn of(&mut self, component: &str, variable: &Variable) -> Option<Arc<DeclaredType>> {
        let declared = variable.declared_type.as_ref();
        let declared = declared.filter(|_| variable.of_type == Type::Enumeration)?;
        let known = self.0.entry(declared.name.clone()).or_insert_with(|| declared.clone());
        if known == declared {
            return Some(declared.clone());
        }
        let name = format!("{component}.{}", declared.name);
        let own = DeclaredType { name: name.clone(), ..DeclaredType::clone(declared) };
        Some(self.0.entry(name).or_insert_with(|| own.into()).clone())
    }
}

/// The definitions of all units; one that FMUs define differently has none.
fn units(plan: &Plan, exposed: &[Exposed]) -> BTreeMap<String, Vec<(String, f64)>> {
    let mut units: BTreeMap<String, Vec<(String, f64)>> = BTreeMap::new();
    let mut known = HashMap::new();
    for Exposed { variable, id, .. } in exposed {
        let Some(unit) = &variable.unit else { continue };
        let definition = id.fmu(&plan.components).unit(unit);
        let first = *known.entry(unit).or_insert(definition);
        let definition = definition.filter(|_| first == definition);
        units.insert(unit.clone(), definition.unwrap_or_default().to_vec());
    }
    units
}
