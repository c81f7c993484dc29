//! `SystemStructure.ssd`: the description of a system in SSP definitions.

use std::collections::{BTreeMap, HashSet};

use anyhow::Result;
use fmu_description::xml::Element;
use fmu_description::{Causality, Type, Value, Variable};

use super::vocabulary;
use crate::{Experiment, Fmu, LoadedComponent, Plan};

/// The name of every set of start values: tools select sets of all components by one name.
const PARAMETER_SET: &str = "initialValues";

const BASE_UNIT: [&str; 10] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset"];

/// The document of a system whose components have the names `identifiers` and FMUs at `places` in the
/// package.
///
/// # Errors
/// A name has a character that XML does not allow.
pub fn document(
    name: &str,
    plan: &Plan,
    identifiers: &[String],
    places: &[String],
) -> Result<String> {
    let Experiment { start, stop, step } = plan.experiment;
    let sides = Vec::from_iter(plan.components.iter().map(sides));
    let mut definitions = Definitions::default();
    let components = plan.components.iter().enumerate().map(|(index, planned)| {
        let (name, place) = (&identifiers[index], &places[index]);
        let implementation = match planned.integrates() {
            true => "ModelExchange",
            false => "CoSimulation",
        };
        Element::new(vocabulary::COMPONENT)
            .with("name", name)
            .with("type", vocabulary::FMU_TYPE)
            .with("source", place)
            .with("implementation", implementation)
            .listing(
                vocabulary::CONNECTORS,
                connectors(&sides[index], &planned.fmu, &mut definitions),
            )
            .holding(area(index, &sides[index]))
            .listing(vocabulary::BINDINGS, bindings(planned, &mut definitions))
    });
    let components = components.collect();
    let connections = plan.connections.iter().map(|connection| {
        let [from, to] = [connection.from, connection.to].map(|id| id.variable(&plan.components));
        Element::new(vocabulary::CONNECTION)
            .with("startElement", &identifiers[connection.from.component])
            .with("startConnector", &from.name)
            .with("endElement", &identifiers[connection.to.component])
            .with("endConnector", &to.name)
            .with_some("suppressUnitConversion", connection.conversion.map(|_| true))
            .holding_all(connection.conversion.map(|conversion| {
                Element::new(vocabulary::LINEAR)
                    .with("factor", real(conversion.factor))
                    .with("offset", real(conversion.offset))
            }))
    });
    let name = identifier(name);
    let system = Element::new(vocabulary::SYSTEM)
        .with("name", &name)
        .listing(vocabulary::ELEMENT_LIST, components)
        .listing(vocabulary::CONNECTIONS, connections.collect())
        .listing(vocabulary::ANNOTATIONS, vec![master(step)]);
    // The step in an annotation that libcosim reads.
    let fixed_step = Element::new(vocabulary::OSP_FIXED_STEP).with("baseStepSize", real(step));
    let annotation = Element::new(vocabulary::ANNOTATION)
        .with("type", "com.opensimulationplatform")
        .holding(Element::new("osp:Algorithm").holding(fixed_step));
    let experiment = Element::new(vocabulary::EXPERIMENT)
        .with("startTime", real(start))
        .with("stopTime", real(stop))
        .listing(vocabulary::ANNOTATIONS, vec![annotation]);
    let tool = concat!("cargo-fmu ", env!("CARGO_PKG_VERSION"));
    // Declared here, where every tool accepts them.
    let structure = Element::new(vocabulary::STRUCTURE);
    let structure = vocabulary::NAMESPACES[..5]
        .iter()
        .fold(structure, |structure, (key, uri)| structure.with(key, uri));
    structure
        .with("version", "1.0")
        .with("name", name)
        // The standard has no attribute for the step.
        .with("description", format!("communication step {step} s"))
        .with("generationTool", tool)
        .holding(system)
        .listing("ssd:Enumerations", definitions.enumerations())
        .listing(vocabulary::UNITS, definitions.units())
        .holding(experiment)
        .document()
}

/// The name in a package, an identifier, as OMSimulator requires: other characters than ASCII letters, digits
/// and `_` become `_`, and `c_` comes before one that does not begin with a letter.
pub fn identifier(name: &str) -> String {
    let valid = name.replace(|c: char| !c.is_ascii_alphanumeric(), "_");
    if valid.starts_with(|c: char| c.is_ascii_alphabetic()) { valid } else { format!("c_{valid}") }
}

/// The variables of a component that have connectors, by side: inputs, outputs, and the parameters that the
/// system sets.
type Sides<'a> = [Vec<&'a Variable>; 3];

fn sides(component: &LoadedComponent) -> Sides<'_> {
    let set: HashSet<_> = component.starts().map(|(variable, _)| &variable.name).collect();
    let is_on = |side: usize, v: &Variable| match side {
        0 => v.causality == Causality::Input,
        1 => v.causality == Causality::Output,
        _ => v.is_parameter() && set.contains(&v.name),
    };
    let all = &component.fmu.variables;
    [0, 1, 2].map(|side| all.iter().filter(|v| is_on(side, v)).collect())
}

fn connectors(
    sides: &Sides<'_>,
    fmu: &Fmu,
    definitions: &mut Definitions,
) -> Vec<Element<'static>> {
    let mut connectors = Vec::new();
    for (side, kind) in ["input", "output", "parameter"].into_iter().enumerate() {
        for (index, variable) in sides[side].iter().enumerate() {
            let height = 1.0 - (index as f64 + 0.5) / sides[side].len() as f64;
            let (x, y) = [(0.0, height), (1.0, height), (1.0 - height, 0.0)][side];
            let geometry = Element::new("ssd:ConnectorGeometry");
            let connector = Element::new(vocabulary::CONNECTOR)
                .with("name", &variable.name)
                .with("kind", kind)
                .holding(definitions.type_or_value(fmu, variable, None))
                .holding(geometry.with("x", x).with("y", y));
            connectors.push(connector);
        }
    }
    connectors
}

/// The start values, stored in the component itself, where all tools read them.
fn bindings(component: &LoadedComponent, definitions: &mut Definitions) -> Vec<Element<'static>> {
    let parameters = component.starts().map(|(variable, value)| {
        Element::new(vocabulary::PARAMETER)
            .with("name", &variable.name)
            .holding(definitions.type_or_value(&component.fmu, variable, Some(value)))
    });
    let parameters = Vec::from_iter(parameters);
    if parameters.is_empty() {
        return vec![];
    }
    let set = Element::new(vocabulary::PARAMETER_SET)
        .with("version", "1.0")
        .with("name", PARAMETER_SET)
        .listing(vocabulary::PARAMETERS, parameters);
    let values = Element::new(vocabulary::VALUES).holding(set);
    vec![Element::new(vocabulary::BINDING).holding(values)]
}

/// A number in XML notation that reads back exactly.
fn real(value: f64) -> String {
    match value {
        f64::INFINITY => "INF".into(),
        f64::NEG_INFINITY => "-INF".into(),
        _ => format!("{value:?}"),
    }
}

/// The area of a component in the diagram, in which all stand side by side, and tools draw the connections.
fn area(index: usize, [inputs, outputs, _]: &Sides<'_>) -> Element<'static> {
    let (left, height) = (80 * index, 5 * (inputs.len().max(outputs.len()).max(2) + 1));
    let ends = [("x1", left), ("y1", 0), ("x2", left + 40), ("y2", height)];
    let area = Element::new("ssd:ElementGeometry");
    ends.into_iter().fold(area, |area, (end, value)| area.with(end, value))
}

/// The master that OMSimulator steps a system with; it opens no system without one. Its library reads the
/// element inside, its Python package the attributes, which include the name of its default solver.
fn master(step: f64) -> Element<'static> {
    let master = Element::new(vocabulary::OMS_MASTER)
        .with("description", "oms-ma")
        .with("stepSize", real(step))
        // Its defaults. This master has no error control, but passes the second to the FMUs.
        .with("absoluteTolerance", "0.0001")
        .with("relativeTolerance", "0.0001");
    let information = Element::new(vocabulary::OMS_INFORMATION)
        .with("name", "oms_ma_default")
        .with("method", "oms_ma")
        .with("fixedStepSize", real(step))
        .holding(master);
    Element::new(vocabulary::ANNOTATION)
        .with("type", "org.openmodelica")
        .listing("oms:Annotations", vec![information])
}

/// The units and enumerations that a system uses.
#[derive(Default)]
struct Definitions {
    units: BTreeMap<String, Vec<(String, f64)>>,
    enumerations: BTreeMap<String, Vec<(String, i64)>>,
}

impl Definitions {
    /// The unit of a variable; `None` if the FMU does not define it or another FMU defines it
    /// differently. Tools then use the unit of the FMU's variable.
    fn unit(&mut self, fmu: &Fmu, variable: &Variable) -> Option<String> {
        let name = variable.unit.as_ref()?;
        let base = fmu.unit(name)?;
        let known = self.units.entry(name.clone());
        (known.or_insert_with(|| base.to_vec()) == base).then(|| name.clone())
    }

    /// The name of a variable's enumeration: the names of the FMU and of the type, since two FMUs may use
    /// one name for different types.
    fn enumeration(&mut self, fmu: &Fmu, variable: &Variable) -> String {
        let of_type = variable.declared_type.as_ref().map(|of_type| &of_type.name);
        let of_type = of_type.unwrap_or(&variable.name);
        let file = fmu.path.file_stem().unwrap_or_default().to_string_lossy();
        let name = format!("{file}.{of_type}");
        let items = variable.items().iter();
        let items = items.map(|item| (item.name.clone(), item.value));
        self.enumerations.insert(name.clone(), items.collect());
        name
    }

    /// The type of a variable, or its value.
    fn type_or_value(
        &mut self,
        fmu: &Fmu,
        variable: &Variable,
        value: Option<&Value>,
    ) -> Element<'static> {
        let (of_type, of_value, term) = match variable.of_type {
            Type::Boolean => ("ssc:Boolean", vocabulary::BOOLEAN_VALUE, None),
            Type::String => ("ssc:String", vocabulary::STRING_VALUE, None),
            Type::Enumeration => {
                let name = self.enumeration(fmu, variable);
                ("ssc:Enumeration", vocabulary::ENUMERATION_VALUE, Some(("name", name)))
            }
            kind if kind.is_float() => {
                let unit = self.unit(fmu, variable);
                (vocabulary::REAL, vocabulary::REAL_VALUE, unit.map(|unit| ("unit", unit)))
            }
            _ => ("ssc:Integer", vocabulary::INTEGER_VALUE, None),
        };
        let mut element = Element::new(value.map_or(of_type, |_| of_value));
        if let Some(value) = value {
            let mut items = variable.items().iter();
            let text = match (value, value.as_real()) {
                (_, Some(number)) => Some(real(number)),
                (Value::Enumeration(number), _) => {
                    let item = items.find(|item| item.value == *number);
                    item.map(|item| item.name.clone())
                }
                _ => Some(value.to_string()),
            };
            element = element.with_some("value", text);
        }
        match term {
            Some((name, term)) => element.with(name, term),
            None => element,
        }
    }

    fn enumerations(&self) -> Vec<Element<'static>> {
        let item = |(name, value): &(String, i64)| {
            Element::new("ssc:Item").with("name", name).with("value", value)
        };
        let enumerations = self.enumerations.iter().map(|(name, items)| {
            let enumeration = Element::new("ssc:Enumeration").with("name", name);
            enumeration.holding_all(items.iter().map(item))
        });
        enumerations.collect()
    }

    fn units(&self) -> Vec<Element<'static>> {
        let units = self.units.iter().map(|(name, base)| {
            let unit = BASE_UNIT.iter().fold(Element::new(vocabulary::BASE_UNIT), |unit, name| {
                let part = base.iter().find(|(known, _)| known == name);
                unit.with_some(name, part.map(|(_, value)| value))
            });
            Element::new(vocabulary::UNIT).with("name", name).holding(unit)
        });
        units.collect()
    }
}
