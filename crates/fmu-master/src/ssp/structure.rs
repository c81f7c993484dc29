//! `SystemStructure.ssd`: the description of a system in SSP definitions.

use std::collections::{BTreeMap, HashSet};

use anyhow::Result;
use fmu_description::xml::Element;
use fmu_description::{Causality, FmiVersion, Type, Value, Variable};

use super::vocabulary;
use crate::components::ScalarId;
use crate::start::ComponentStarts;
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
    let needs_2 = plan.components.iter().zip(&sides).any(|(c, sides)| needs_ssp_2(c, sides));
    let mut definitions = Definitions { is_ssp_2: needs_2, ..Definitions::default() };
    let version = definitions.version();
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
            .with_some("startIndices", indices(plan, connection.from))
            .with("endElement", &identifiers[connection.to.component])
            .with("endConnector", &to.name)
            .with_some("endIndices", indices(plan, connection.to))
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
        .with("version", version)
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
    [0, 1, 2].map(|side| component.fmu.variables.iter().filter(|v| is_on(side, v)).collect())
}

/// Whether a connector or a start value of a component does not exist in SSP 1.0.
fn needs_ssp_2(component: &LoadedComponent, sides: &Sides<'_>) -> bool {
    let started = component.starts().map(|(variable, _)| variable);
    sides.iter().flatten().copied().chain(started).any(|variable| {
        let is_known = match variable.of_type {
            Type::Boolean | Type::String | Type::Enumeration | Type::Binary => true,
            of_type => of_type == Type::Float64 || of_type == Type::Int32,
        };
        !is_known
            || !variable.dimensions.is_empty()
            || !variable.clocks.is_empty()
            || variable.causality == Causality::StructuralParameter
    })
}

/// The indices of an element of an array, from 1; `None` for a scalar.
fn indices(plan: &Plan, id: ScalarId) -> Option<String> {
    let fmu = id.fmu(&plan.components);
    let mut rest = fmu.scalars[id.scalar].element;
    let lengths = fmu.variable(id.scalar).dimensions.iter().rev();
    let mut indices = Vec::from_iter(lengths.map(|length| {
        let index = rest % length + 1;
        rest /= length;
        index.to_string()
    }));
    indices.reverse();
    (!indices.is_empty()).then(|| indices.join(" "))
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
            let kind = match variable.causality {
                Causality::StructuralParameter => "structuralParameter",
                _ => kind,
            };
            let connector = Element::new(vocabulary::CONNECTOR)
                .with("name", &variable.name)
                .with("kind", kind)
                .holding(definitions.type_or_value(fmu, variable, &[]))
                .holding_all(dimensions(variable))
                .holding_all(clocks(fmu, variable))
                .holding(geometry.with("x", x).with("y", y));
            connectors.push(connector);
        }
    }
    connectors
}

/// The start values, stored in the component itself, where all tools read them.
fn bindings(component: &LoadedComponent, definitions: &mut Definitions) -> Vec<Element<'static>> {
    let fmu = &component.fmu;
    let starts = ComponentStarts::new(component.starts.iter());
    let mut arrays = HashSet::new();
    let is_value = |scalar: &usize| fmu.variable(*scalar).of_type != Type::Clock;
    let scalars = component.starts.iter().map(|(scalar, _)| *scalar).filter(is_value);
    let scalars = scalars.map(|scalar| fmu.array(scalar));
    // An array has all its values, those of the FMU if the system sets some elements only.
    let parameters = scalars.filter(|array| arrays.insert(array.start)).map(|array| {
        let variable = fmu.variable(array.start);
        let values = Vec::from_iter(array.map(|scalar| starts.value(scalar, fmu)));
        Element::new(vocabulary::PARAMETER)
            .with("name", &variable.name)
            .holding(definitions.type_or_value(fmu, variable, &values))
            .holding_all(dimensions(variable))
    });
    let parameters = Vec::from_iter(parameters);
    if parameters.is_empty() {
        return vec![];
    }
    let set = Element::new(vocabulary::PARAMETER_SET)
        .with("version", definitions.version())
        .with("name", PARAMETER_SET)
        .listing(vocabulary::PARAMETERS, parameters);
    let values = Element::new(vocabulary::VALUES).holding(set);
    vec![Element::new(vocabulary::BINDING).holding(values)]
}

/// The clocks at whose ticks a variable changes.
fn clocks(fmu: &Fmu, variable: &Variable) -> Vec<Element<'static>> {
    let is_one = |v: &&Variable| v.of_type == Type::Clock && variable.clocks.contains(&v.reference);
    let named =
        |clock: &Variable| Element::new(vocabulary::CLOCK_OF_CONNECTOR).with("name", &clock.name);
    fmu.variables.iter().filter(is_one).map(named).collect()
}

/// The dimensions of an array; none of a scalar.
fn dimensions(variable: &Variable) -> impl Iterator<Item = Element<'static>> {
    let lengths = variable.dimensions.iter();
    lengths.map(|length| Element::new(vocabulary::DIMENSION).with("size", length))
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
    /// Whether the package is of SSP 2.0, which has the types of FMI 3.0.
    is_ssp_2: bool,
    units: BTreeMap<String, Vec<(String, f64)>>,
    enumerations: BTreeMap<String, Vec<(String, i64)>>,
}

impl Definitions {
    /// The version of SSP.
    fn version(&self) -> &'static str {
        if self.is_ssp_2 { "2.0" } else { "1.0" }
    }

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

    /// The type of a variable, or its values.
    fn type_or_value(
        &mut self,
        fmu: &Fmu,
        variable: &Variable,
        values: &[Value],
    ) -> Element<'static> {
        let has_own_types = self.is_ssp_2 && fmu.version == FmiVersion::Fmi3;
        let [of_type, of_value] = match variable.of_type {
            kind if has_own_types => own_type(kind),
            Type::Float64 => [vocabulary::REAL, vocabulary::REAL_VALUE],
            Type::Int32 => ["ssc:Integer", vocabulary::INTEGER_VALUE],
            kind => own_type(kind),
        };
        let term = match variable.of_type {
            Type::Enumeration => Some(("name", self.enumeration(fmu, variable))),
            kind if kind.is_float() => self.unit(fmu, variable).map(|unit| ("unit", unit)),
            Type::Binary => variable.mime_type.clone().map(|of_type| ("mime-type", of_type)),
            Type::Clock => variable.clock.map(|clock| {
                ("intervalVariability", clock.interval_variability.as_str().to_owned())
            }),
            _ => None,
        };
        let mut element = Element::new(if values.is_empty() { of_type } else { of_value });
        let text = |value: &Value| match (value, value.as_real()) {
            (_, Some(number)) => Some(real(number)),
            (Value::Enumeration(number), _) => {
                let item = variable.items().iter().find(|item| item.value == *number);
                item.map(|item| item.name.clone())
            }
            _ => Some(value.to_string()),
        };
        let texts = values.iter().map(text);
        let is_list = !variable.dimensions.is_empty();
        if is_list && matches!(variable.of_type, Type::String | Type::Enumeration) {
            element = element.holding_all(
                texts.map(|text| Element::new(vocabulary::ELEMENT_VALUE).with_some("value", text)),
            );
        } else if is_list {
            let texts = Vec::from_iter(texts.flatten());
            element = element.with_some("value", (!texts.is_empty()).then(|| texts.join(" ")));
        } else {
            element = element.with_some("value", texts.flatten().next());
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

/// The elements of the type and of a value of it, which have the name of the type in FMI 3.0.
fn own_type(of_type: Type) -> [&'static str; 2] {
    match of_type {
        Type::Float64 => [vocabulary::FLOAT64, vocabulary::FLOAT64_VALUE],
        Type::Float32 => [vocabulary::FLOAT32, vocabulary::FLOAT32_VALUE],
        Type::Int8 => ["ssc:Int8", vocabulary::INT8_VALUE],
        Type::UInt8 => ["ssc:UInt8", vocabulary::UINT8_VALUE],
        Type::Int16 => ["ssc:Int16", vocabulary::INT16_VALUE],
        Type::UInt16 => ["ssc:UInt16", vocabulary::UINT16_VALUE],
        Type::Int32 => ["ssc:Int32", vocabulary::INT32_VALUE],
        Type::UInt32 => ["ssc:UInt32", vocabulary::UINT32_VALUE],
        Type::Int64 => ["ssc:Int64", vocabulary::INT64_VALUE],
        Type::UInt64 => ["ssc:UInt64", vocabulary::UINT64_VALUE],
        Type::Boolean => ["ssc:Boolean", vocabulary::BOOLEAN_VALUE],
        Type::String => ["ssc:String", vocabulary::STRING_VALUE],
        Type::Enumeration => ["ssc:Enumeration", vocabulary::ENUMERATION_VALUE],
        Type::Binary => [vocabulary::BINARY, vocabulary::BINARY_VALUE],
        // They have no start values here.
        Type::Clock => [vocabulary::CLOCK, vocabulary::CLOCK],
    }
}
