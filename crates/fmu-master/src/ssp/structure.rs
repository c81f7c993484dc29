//! `SystemStructure.ssd`: the description of a system in SSP terms.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use fmu_description::xml::Element;
use fmu_description::{Causality, Type, Value, Variable};

use super::layout::{self, Area, Layout, Link, Part, Pin};
use crate::{Connection, Description, Fmu, Plan, Planned, Scale};

/// The name of every set of start values: tools select sets of all components by one name.
const PARAMETER_SET: &str = "initialValues";

/// The start of the names of the standard's schemas.
const SSP: &str = "http://ssp-standard.org/SSP1/SystemStructure";
const OSP: &str = "http://opensimulationplatform.com/SSP/OSPAnnotations";
const OMS: &str =
    "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd";

const BASE_UNIT: [&str; 10] = [
    "kg", "m", "s", "A", "K", "mol", "cd", "rad", "factor", "offset",
];

/// The document of a system whose components have the names `identifiers` and FMUs at `places` in the
/// package.
///
/// # Errors
/// A name has a character that XML does not allow.
pub fn document(
    name: &str,
    description: &Description,
    plan: &Plan,
    identifiers: &[String],
    places: &[String],
) -> Result<String> {
    let components = plan.components.iter().zip(identifiers);
    let faces: Vec<Face<'_>> = components.map(|(c, name)| Face::new(c, name)).collect();
    let links = links(description, &faces)?;
    let part = |face: &Face<'_>| Part {
        inputs: face.sides[0].len(),
        outputs: face.sides[1].len(),
    };
    let parts = Vec::from_iter(faces.iter().map(part));
    let layout = layout::lay_out(&parts, &links);
    let mut terms = Terms::default();
    let name = super::identifier(name);

    let components = faces.iter().zip(places).zip(&layout.parts);
    let components =
        components.map(|((face, place), area)| component(face, place, *area, &mut terms));
    let system = Element::new("ssd:System")
        .with("name", &name)
        .listing("ssd:Elements", components.collect())
        .listing(
            "ssd:Connections",
            connections(description, &links, &faces, &layout),
        )
        .holding(area("ssd:SystemGeometry", layout.extent))
        .listing("ssd:Annotations", vec![master(description.step)]);
    let root = Element::new("ssd:SystemStructureDescription")
        // Declared here, where every tool accepts them.
        .with("xmlns:ssc", format!("{SSP}Common"))
        .with("xmlns:ssd", format!("{SSP}Description"))
        .with("xmlns:ssv", format!("{SSP}ParameterValues"))
        .with("xmlns:osp", OSP)
        .with("xmlns:oms", OMS)
        .with("version", "1.0")
        .with("name", name)
        // The standard has no attribute for the step.
        .with(
            "description",
            format!("communication step {} s", description.step),
        )
        .with(
            "generationTool",
            concat!("cargo-fmu ", env!("CARGO_PKG_VERSION")),
        )
        .holding(system)
        .listing("ssd:Enumerations", terms.enumerations())
        .listing("ssd:Units", terms.units())
        .holding(experiment(description));
    root.document()
}

/// A component and its connectors, by side: inputs, outputs, and the parameters that the system sets.
struct Face<'a> {
    component: &'a Planned,
    name: &'a str,
    sides: [Vec<&'a Variable>; 3],
}

/// The kinds of connectors on each side.
const KINDS: [&str; 3] = ["input", "output", "parameter"];

impl<'a> Face<'a> {
    fn new(component: &'a Planned, name: &'a str) -> Self {
        let is_set = |v: &Variable| component.starts().any(|(set, _)| set.name == v.name);
        let is_on = |side: usize, v: &Variable| match side {
            0 => v.causality == Causality::Input,
            1 => v.causality == Causality::Output,
            _ => v.is_parameter() && is_set(v),
        };
        let all = &component.fmu.variables;
        let on = |side| all.iter().filter(move |v| is_on(side, v)).collect();
        Self {
            component,
            name,
            sides: [0, 1, 2].map(on),
        }
    }

    /// The position of a variable on a side.
    fn find(&self, side: usize, variable: &str) -> Option<usize> {
        self.sides[side].iter().position(|v| v.name == variable)
    }
}

/// Finds the two ends of each connection.
fn links(description: &Description, faces: &[Face<'_>]) -> Result<Vec<Link>> {
    let pin = |name: &str, side| {
        let (component, variable) = name.split_once('.')?;
        let part = faces.iter().position(|f| f.component.name == component)?;
        let index = faces[part].find(side, variable)?;
        Some(Pin { part, index })
    };
    let link = |c: &Connection| {
        let (from, to) = (pin(&c.from, 1)?, pin(&c.to, 0)?);
        Some(Link { from, to })
    };
    let links: Option<_> = description.connections.iter().map(link).collect();
    links.context("a connection does not fit")
}

fn component(face: &Face<'_>, place: &str, at: Area, terms: &mut Terms) -> Element<'static> {
    let mut connectors = Vec::new();
    for (side, variables) in face.sides.iter().enumerate() {
        for (index, variable) in variables.iter().enumerate() {
            let height = layout::height(index, variables.len());
            let (x, y) = [(0.0, height), (1.0, height), (1.0 - height, 0.0)][side];
            let geometry = Element::new("ssd:ConnectorGeometry")
                .with("x", x)
                .with("y", y);
            let connector = Element::new("ssd:Connector")
                .with("name", &variable.name)
                .with("kind", KINDS[side])
                .holding(terms.of_type(&face.component.fmu, variable))
                .holding(geometry);
            connectors.push(connector);
        }
    }
    Element::new("ssd:Component")
        .with("name", face.name)
        .with("type", "application/x-fmu-sharedlibrary")
        .with("source", place)
        .with("implementation", "CoSimulation")
        .listing("ssd:Connectors", connectors)
        .holding(area("ssd:ElementGeometry", at))
        .listing("ssd:ParameterBindings", bindings(face, terms))
}

/// The start values, stored in the component itself, where all tools read them.
fn bindings(face: &Face<'_>, terms: &mut Terms) -> Vec<Element<'static>> {
    let fmu = &face.component.fmu;
    let parameters = face.component.starts().map(|(variable, value)| {
        Element::new("ssv:Parameter")
            .with("name", &variable.name)
            .holding(start(variable, value, fmu, terms))
    });
    let parameters = Vec::from_iter(parameters);
    if parameters.is_empty() {
        return vec![];
    }
    let set = Element::new("ssv:ParameterSet")
        .with("version", "1.0")
        .with("name", PARAMETER_SET)
        .listing("ssv:Parameters", parameters);
    let values = Element::new("ssd:ParameterValues").holding(set);
    vec![Element::new("ssd:ParameterBinding").holding(values)]
}

fn start(variable: &Variable, value: &Value, fmu: &Fmu, terms: &mut Terms) -> Element<'static> {
    match (value, value.as_real()) {
        (_, Some(value)) => Element::new("ssv:Real")
            .with("value", real(value))
            .with_some("unit", terms.unit(fmu, variable)),
        (Value::Enumeration(number), _) => {
            let item = variable.items().iter().find(|item| item.value == *number);
            Element::new("ssv:Enumeration")
                .with_some("value", item.map(|item| &item.name))
                .with("name", terms.enumeration(fmu, variable))
        }
        (Value::Boolean(value), _) => Element::new("ssv:Boolean").with("value", value),
        (Value::String(value), _) => Element::new("ssv:String").with("value", value),
        _ => Element::new("ssv:Integer").with("value", value),
    }
}

/// A number in XML notation that reads back exactly.
fn real(value: f64) -> String {
    match value {
        f64::INFINITY => "INF".into(),
        f64::NEG_INFINITY => "-INF".into(),
        _ => format!("{value:?}"),
    }
}

fn connections(
    description: &Description,
    links: &[Link],
    faces: &[Face<'_>],
    layout: &Layout,
) -> Vec<Element<'static>> {
    let connection = |link: &Link, line: &[(f64, f64)], scale: Option<Scale>| {
        let (from, to) = (&faces[link.from.part], &faces[link.to.part]);
        let list = |of: fn((f64, f64)) -> f64| {
            let texts = line.iter().map(|point| of(*point).to_string());
            Vec::from_iter(texts).join(" ")
        };
        Element::new("ssd:Connection")
            .with("startElement", from.name)
            .with("startConnector", &from.sides[1][link.from.index].name)
            .with("endElement", to.name)
            .with("endConnector", &to.sides[0][link.to.index].name)
            .with_some("suppressUnitConversion", scale.map(|_| true))
            .holding_all(scale.map(|scale| {
                Element::new("ssc:LinearTransformation")
                    .with("factor", real(scale.factor))
                    .with("offset", real(scale.offset))
            }))
            .holding(
                Element::new("ssd:ConnectionGeometry")
                    .with("pointsX", list(|(x, _)| x))
                    .with("pointsY", list(|(_, y)| y)),
            )
    };
    let scales = description.connections.iter().map(|c| c.scale);
    let lines = links.iter().zip(&layout.lines).zip(scales);
    lines
        .map(|((link, line), scale)| connection(link, line, scale))
        .collect()
}

fn area(name: &'static str, Area { x1, y1, x2, y2 }: Area) -> Element<'static> {
    Element::new(name)
        .with("x1", x1)
        .with("y1", y1)
        .with("x2", x2)
        .with("y2", y2)
}

/// The start and stop times, and the step in an annotation that libcosim reads.
fn experiment(description: &Description) -> Element<'static> {
    let step = Element::new("osp:FixedStepAlgorithm").with("baseStepSize", real(description.step));
    let algorithm = Element::new("osp:Algorithm").holding(step);
    let annotation = Element::new("ssc:Annotation")
        .with("type", "com.opensimulationplatform")
        .holding(algorithm);
    Element::new("ssd:DefaultExperiment")
        .with("startTime", real(description.start))
        .with("stopTime", real(description.stop))
        .listing("ssd:Annotations", vec![annotation])
}

/// The master that OMSimulator steps a system with; it opens no system without one. Its library reads the
/// element inside, its Python package the attributes, which include the name of its default solver.
fn master(step: f64) -> Element<'static> {
    let master = Element::new("oms:FixedStepMaster")
        .with("description", "oms-ma")
        .with("stepSize", real(step))
        // Its defaults. This master has no error control, but passes the second to the FMUs.
        .with("absoluteTolerance", "0.0001")
        .with("relativeTolerance", "0.0001");
    let information = Element::new("oms:SimulationInformation")
        .with("name", "oms_ma_default")
        .with("method", "oms_ma")
        .with("fixedStepSize", real(step))
        .holding(master);
    Element::new("ssc:Annotation")
        .with("type", "org.openmodelica")
        .listing("oms:Annotations", vec![information])
}

/// The units and enumerations that a system uses.
#[derive(Default)]
struct Terms {
    units: BTreeMap<String, Vec<(String, f64)>>,
    enumerations: BTreeMap<String, Vec<(String, i64)>>,
}

impl Terms {
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

    /// The type of a variable.
    fn of_type(&mut self, fmu: &Fmu, variable: &Variable) -> Element<'static> {
        match variable.of_type {
            Type::Boolean => Element::new("ssc:Boolean"),
            Type::String => Element::new("ssc:String"),
            Type::Enumeration => {
                Element::new("ssc:Enumeration").with("name", self.enumeration(fmu, variable))
            }
            kind if kind.is_float() => {
                Element::new("ssc:Real").with_some("unit", self.unit(fmu, variable))
            }
            _ => Element::new("ssc:Integer"),
        }
    }

    fn enumerations(&self) -> Vec<Element<'static>> {
        let item = |(name, value): &(String, i64)| {
            Element::new("ssc:Item")
                .with("name", name)
                .with("value", value)
        };
        let enumerations = self.enumerations.iter().map(|(name, items)| {
            let enumeration = Element::new("ssc:Enumeration").with("name", name);
            enumeration.holding_all(items.iter().map(item))
        });
        enumerations.collect()
    }

    fn units(&self) -> Vec<Element<'static>> {
        let units = self.units.iter().map(|(name, base)| {
            let unit = BASE_UNIT
                .iter()
                .fold(Element::new("ssc:BaseUnit"), |unit, name| {
                    let part = base.iter().find(|(known, _)| known == name);
                    unit.with_some(name, part.map(|(_, value)| value))
                });
            Element::new("ssc:Unit").with("name", name).holding(unit)
        });
        units.collect()
    }
}
