//! `SystemStructure.ssd`: the description of a system in SSP terms.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use fmu_description::{Causality, VariableType};

use crate::{Connection, Description, Fmu, Plan, Planned, Scale, Typed, Variable};

use super::layout::{self, Area, Layout, Link, Part, Pin};
use super::names;
use fmu_description::xml::Element;

/// The name of every set of start values: tools select sets of all components by one name.
const PARAMETER_SET: &str = "initialValues";

/// Declared at the root, where every tool accepts them.
const NAMESPACES: [(&str, &str); 5] = [
    (
        "xmlns:ssc",
        "http://ssp-standard.org/SSP1/SystemStructureCommon",
    ),
    (
        "xmlns:ssd",
        "http://ssp-standard.org/SSP1/SystemStructureDescription",
    ),
    (
        "xmlns:ssv",
        "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    ),
    (
        "xmlns:osp",
        "http://opensimulationplatform.com/SSP/OSPAnnotations",
    ),
    (
        "xmlns:oms",
        "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    ),
];

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
    let components = plan.components().iter().zip(identifiers);
    let faces: Vec<Face<'_>> = components.map(|(c, name)| Face::new(c, name)).collect();
    let links = links(description, &faces)?;
    let parts: Vec<Part> = faces.iter().map(Face::part).collect();
    let layout = layout::lay_out(&parts, &links);
    let mut terms = Terms::default();
    let name = names::identifier(name);

    let components = faces.iter().zip(places).zip(&layout.parts);
    let components = components
        .map(|((face, place), area)| component(face, place, *area, &mut terms))
        .collect();
    let system = Element::new("ssd:System")
        .with("name", &name)
        .listing("ssd:Elements", components)
        .listing(
            "ssd:Connections",
            connections(description, &links, &faces, &layout),
        )
        .holding(area("ssd:SystemGeometry", layout.extent))
        .listing("ssd:Annotations", vec![master(description.step)]);
    let root = Element::new("ssd:SystemStructureDescription");
    let root = NAMESPACES
        .into_iter()
        .fold(root, |root, (name, uri)| root.with(name, uri))
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
    Ok(root.document()?)
}

/// A component and its connectors, by side.
struct Face<'a> {
    component: &'a Planned,
    name: &'a str,
    inputs: Vec<&'a Variable>,
    outputs: Vec<&'a Variable>,
    /// The parameters that the system sets.
    parameters: Vec<&'a Variable>,
}

impl<'a> Face<'a> {
    fn new(component: &'a Planned, name: &'a str) -> Self {
        let all = |causality| {
            let variables = component.fmu.variables.iter();
            variables.filter(move |v| v.causality == causality)
        };
        let is_set = |v: &&Variable| component.starts().any(|(set, _)| set.name == v.name);
        Self {
            component,
            name,
            inputs: all(Causality::Input).collect(),
            outputs: all(Causality::Output).collect(),
            parameters: all(Causality::Parameter).filter(is_set).collect(),
        }
    }

    fn part(&self) -> Part {
        Part {
            inputs: self.inputs.len(),
            outputs: self.outputs.len(),
        }
    }
}

/// Finds the two ends of each connection.
fn links(description: &Description, faces: &[Face<'_>]) -> Result<Vec<Link>> {
    let link = |connection: &Connection| {
        Some(Link {
            from: pin(faces, &connection.from, |face| face.outputs.as_slice())?,
            to: pin(faces, &connection.to, |face| face.inputs.as_slice())?,
        })
    };
    let links = description.connections.iter().map(link);
    links
        .collect::<Option<_>>()
        .context("a connection does not fit")
}

/// The position of `component.variable` on a side of its component.
fn pin<'a>(
    faces: &'a [Face<'a>],
    name: &str,
    side: fn(&'a Face<'a>) -> &'a [&'a Variable],
) -> Option<Pin> {
    let (component, variable) = name.split_once('.')?;
    let part = faces.iter().position(|f| f.component.name == component)?;
    let index = side(&faces[part]).iter().position(|v| v.name == variable)?;
    Some(Pin { part, index })
}

fn component(face: &Face<'_>, place: &str, at: Area, terms: &mut Terms) -> Element<'static> {
    let fmu = &face.component.fmu;
    let mut connectors = Vec::new();
    let (count, left) = (face.inputs.len(), 0.0);
    for (index, input) in face.inputs.iter().enumerate() {
        let at = (left, layout::height(index, count));
        connectors.push(connector(input, "input", at, fmu, terms));
    }
    let (count, right) = (face.outputs.len(), 1.0);
    for (index, output) in face.outputs.iter().enumerate() {
        let at = (right, layout::height(index, count));
        connectors.push(connector(output, "output", at, fmu, terms));
    }
    let (count, bottom) = (face.parameters.len(), 0.0);
    for (index, parameter) in face.parameters.iter().enumerate() {
        let at = (1.0 - layout::height(index, count), bottom);
        connectors.push(connector(parameter, "parameter", at, fmu, terms));
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

fn connector(
    variable: &Variable,
    kind: &'static str,
    (x, y): (f64, f64),
    fmu: &Fmu,
    terms: &mut Terms,
) -> Element<'static> {
    let of_type = match variable.kind {
        VariableType::Boolean => Element::new("ssc:Boolean"),
        VariableType::String => Element::new("ssc:String"),
        VariableType::Enumeration => {
            Element::new("ssc:Enumeration").with("name", terms.enumeration(fmu, variable))
        }
        kind if kind.is_float() => {
            Element::new("ssc:Real").with_some("unit", terms.unit(fmu, variable))
        }
        _ => Element::new("ssc:Integer"),
    };
    let geometry = Element::new("ssd:ConnectorGeometry")
        .with("x", x)
        .with("y", y);
    Element::new("ssd:Connector")
        .with("name", &variable.name)
        .with("kind", kind)
        .holding(of_type)
        .holding(geometry)
}

/// The start values, stored in the component itself, where all tools read them.
fn bindings(face: &Face<'_>, terms: &mut Terms) -> Vec<Element<'static>> {
    let fmu = &face.component.fmu;
    let parameters: Vec<Element<'static>> = face
        .component
        .starts()
        .map(|(variable, value)| {
            Element::new("ssv:Parameter")
                .with("name", &variable.name)
                .holding(start(variable, value, fmu, terms))
        })
        .collect();
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

fn start(variable: &Variable, value: &Typed, fmu: &Fmu, terms: &mut Terms) -> Element<'static> {
    match value {
        Typed::Real(value) => Element::new("ssv:Real")
            .with("value", real(*value))
            .with_some("unit", terms.unit(fmu, variable)),
        Typed::Integer(number) if variable.kind == VariableType::Enumeration => {
            let mut items = variable.items.iter();
            let item = items.find(|(_, known)| i128::from(*known) == *number);
            Element::new("ssv:Enumeration")
                .with_some("value", item.map(|(name, _)| name))
                .with("name", terms.enumeration(fmu, variable))
        }
        Typed::Integer(value) => Element::new("ssv:Integer").with("value", value),
        Typed::Boolean(value) => Element::new("ssv:Boolean").with("value", value),
        Typed::String(value) => Element::new("ssv:String").with("value", value.to_string_lossy()),
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
        Element::new("ssd:Connection")
            .with("startElement", from.name)
            .with("startConnector", &from.outputs[link.from.index].name)
            .with("endElement", to.name)
            .with("endConnector", &to.inputs[link.to.index].name)
            .with_some("suppressUnitConversion", scale.map(|_| true))
            .holding_all(scale.map(transformation))
            .holding(
                Element::new("ssd:ConnectionGeometry")
                    .with("pointsX", list(line.iter().map(|(x, _)| *x)))
                    .with("pointsY", list(line.iter().map(|(_, y)| *y))),
            )
    };
    let scales = description.connections.iter().map(|c| c.scale);
    let lines = links.iter().zip(&layout.lines).zip(scales);
    lines
        .map(|((link, line), scale)| connection(link, line, scale))
        .collect()
}

/// The conversion of a value to another unit.
fn transformation(Scale { factor, offset }: Scale) -> Element<'static> {
    Element::new("ssc:LinearTransformation")
        .with("factor", real(factor))
        .with("offset", real(offset))
}

fn list(values: impl Iterator<Item = f64>) -> String {
    let texts: Vec<String> = values.map(|value| value.to_string()).collect();
    texts.join(" ")
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
/// element inside, its Python package the attributes, of which the name is that of its default solver.
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
        let known = self
            .units
            .entry(name.clone())
            .or_insert_with(|| base.to_vec());
        (known == base).then(|| name.clone())
    }

    /// The name of a variable's enumeration: those of the FMU and of the type, since two FMUs may use
    /// one name for different types.
    fn enumeration(&mut self, fmu: &Fmu, variable: &Variable) -> String {
        let of_type = variable.declared_type.as_ref().unwrap_or(&variable.name);
        let file = fmu.path.file_stem().unwrap_or_default().to_string_lossy();
        let name = format!("{file}.{of_type}");
        self.enumerations
            .insert(name.clone(), variable.items.clone());
        name
    }

    fn enumerations(&self) -> Vec<Element<'static>> {
        let item = |(name, value): &(String, i64)| {
            Element::new("ssc:Item")
                .with("name", name)
                .with("value", value)
        };
        let enumerations = self.enumerations.iter();
        enumerations
            .map(|(name, items)| {
                Element::new("ssc:Enumeration")
                    .with("name", name)
                    .holding_all(items.iter().map(item))
            })
            .collect()
    }

    fn units(&self) -> Vec<Element<'static>> {
        let units = self.units.iter();
        units
            .map(|(name, base)| {
                let part = |name: &str| base.iter().find(|(known, _)| known == name);
                let base = BASE_UNIT
                    .iter()
                    .fold(Element::new("ssc:BaseUnit"), |unit, name| {
                        unit.with_some(name, part(name).map(|(_, value)| value))
                    });
                Element::new("ssc:Unit").with("name", name).holding(base)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_xml_schema_and_read_back_exactly() {
        let texts = [0.1 + 0.2, -1e-300, 1e22, f64::INFINITY, -f64::INFINITY].map(real);
        assert_eq!(
            texts,
            ["0.30000000000000004", "-1e-300", "1e22", "INF", "-INF"]
        );
        assert_eq!(real(f64::NAN), "NaN");
    }
}
