//! Generates the model description from a model's table.

use crate::xml::Element;
use crate::{
    Capability, Causality, Domain, Enumeration, Info, Initial, Unit, Variable, guid, unit,
};

/// The parts of a model description other than the variables.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Name of the model and its `modelIdentifier`: a C identifier.
    pub name: &'a str,
    /// Description of the model.
    pub description: &'a str,
    /// Version of the model.
    pub version: &'a str,
    /// SPDX expression.
    pub license: &'a str,
    /// The tool that generated the FMU.
    pub generation_tool: &'a str,
    /// The capability flags that are true.
    pub capabilities: &'a [Capability],
    /// Stop time and step size of the default experiment (s), which starts at 0.
    pub default_experiment: (f64, f64),
    /// Name and description of each log category.
    pub log_categories: &'a [(&'a str, &'a str)],
}

/// A scalar, or an element of an array with its index from 0.
type Scalar<'a> = (&'a Info, usize);

/// Generates the model description of `subject` with the variables of its table, in the order of the
/// standard's schema.
///
/// `dependencies` of the outputs are empty: outputs change in `fmi2DoStep` only and never depend on
/// an input at the same communication point, so importers see no false algebraic loops.
pub fn describe<M>(subject: &Subject<'_>, variables: &[Variable<M>]) -> Element<'static> {
    let infos: Vec<&Info> = variables.iter().map(|v| &v.info).collect();
    let scalars: Vec<Scalar<'_>> = infos
        .iter()
        .flat_map(|v| (0..v.count()).map(move |element| (*v, element)))
        .collect();
    let (stop, step) = subject.default_experiment;
    Element::new("fmiModelDescription")
        .with("fmiVersion", "2.0")
        .with("modelName", subject.name)
        .with(
            "guid",
            String::from_utf8_lossy(&guid::guid(subject.name, variables)),
        )
        .with("description", subject.description)
        .with("version", subject.version)
        .with("license", subject.license)
        .with("generationTool", subject.generation_tool)
        .with("variableNamingConvention", "structured")
        .holding(co_simulation(subject))
        .listing("UnitDefinitions", units(&infos))
        .listing("TypeDefinitions", types(&infos))
        .holding(
            Element::new("LogCategories")
                .holding_all(subject.log_categories.iter().map(log_category)),
        )
        .holding(
            Element::new("DefaultExperiment")
                .with("startTime", 0)
                .with("stopTime", stop)
                .with("stepSize", step),
        )
        .holding(Element::new("ModelVariables").holding_all((0..).zip(&scalars).map(scalar)))
        .holding(
            Element::new("ModelStructure")
                .listing("Outputs", unknowns(&scalars, |_| String::new()))
                .listing(
                    "InitialUnknowns",
                    unknowns(&scalars, |scalar| initial_dependencies(&scalars, scalar)),
                ),
        )
}

fn co_simulation(subject: &Subject<'_>) -> Element<'static> {
    let mut element = Element::new("CoSimulation").with("modelIdentifier", subject.name);
    for capability in Capability::ALL {
        // The position of this number among the flags.
        if *capability == Capability::CanRunAsynchronuously {
            element = element.with("maxOutputDerivativeOrder", 0);
        }
        element = element.with(
            capability.as_str(),
            subject.capabilities.contains(capability),
        );
    }
    element
}

fn log_category((name, description): &(&str, &str)) -> Element<'static> {
    Element::new("Category")
        .with("name", name)
        .with("description", description)
}

/// The elements generated from the variables, without duplicates.
fn distinct(
    variables: &[&Info],
    of: impl Fn(&Domain) -> Option<Element<'static>>,
) -> Vec<Element<'static>> {
    let mut found = Vec::new();
    for item in variables.iter().filter_map(|v| of(&v.domain)) {
        if !found.contains(&item) {
            found.push(item);
        }
    }
    found
}

fn units(variables: &[&Info]) -> Vec<Element<'static>> {
    distinct(variables, |domain| match domain {
        Domain::Real { unit, .. } => Some(unit_definition(unit)),
        _ => None,
    })
}

fn unit_definition(unit: &Unit) -> Element<'static> {
    let base = unit::BASE
        .into_iter()
        .zip(unit.exponents)
        .filter(|(_, exponent)| *exponent != 0)
        .fold(Element::new("BaseUnit"), |base, (name, exponent)| {
            base.with(name, exponent)
        });
    let display = unit.display.map(|(name, factor)| {
        Element::new("DisplayUnit")
            .with("name", name)
            .with("factor", factor)
    });
    Element::new("Unit")
        .with("name", unit.name)
        .holding(base)
        .holding_all(display)
}

fn types(variables: &[&Info]) -> Vec<Element<'static>> {
    distinct(variables, |domain| match domain {
        Domain::Enumeration { items, .. } => Some(enumeration(items)),
        _ => None,
    })
}

fn enumeration(enumeration: &Enumeration) -> Element<'static> {
    let item = |(value, (name, description)): (i32, &(&str, &str))| {
        Element::new("Item")
            .with("name", name)
            .with("value", value)
            .with("description", description)
    };
    Element::new("SimpleType")
        .with("name", enumeration.name)
        .with("description", enumeration.description)
        .holding(Element::new("Enumeration").holding_all((1..).zip(enumeration.items).map(item)))
}

fn scalar((reference, (v, element)): (u32, &Scalar<'_>)) -> Element<'static> {
    let initial = Initial::default_for(v.causality, v.variability);
    Element::new("ScalarVariable")
        .with("name", v.element_name(*element))
        .with("valueReference", reference)
        .with("description", v.description)
        .with("causality", v.causality.as_str())
        .with("variability", v.variability.as_str())
        .with_some("initial", initial.map(Initial::as_str))
        .holding(value(&v.domain, *element))
}

/// The element of the type, with the start value and the bounds.
fn value(domain: &Domain, element: usize) -> Element<'static> {
    match domain {
        Domain::Real {
            start,
            min,
            max,
            unit,
        } => {
            let bound = |bound: &f64| bound.is_finite().then_some(*bound);
            Element::new("Real")
                .with("unit", unit.name)
                .with_some("displayUnit", unit.display.map(|(name, _)| name))
                .with_some("min", bound(min))
                .with_some("max", bound(max))
                .with_some("start", start.of(element))
        }
        Domain::Integer { start, range } => Element::new("Integer")
            .with("min", range.0)
            .with("max", range.1)
            .with("start", start),
        Domain::Boolean { start } => Element::new("Boolean").with("start", start),
        Domain::Enumeration { start, items } => Element::new("Enumeration")
            .with("declaredType", items.name)
            .with("min", 1)
            .with("max", items.items.len())
            .with("start", start),
    }
}

/// The outputs, with the indices of the variables that each depends on.
fn unknowns(
    scalars: &[Scalar<'_>],
    dependencies: impl Fn(&Scalar<'_>) -> String,
) -> Vec<Element<'static>> {
    (1..)
        .zip(scalars)
        .filter(|(_, (v, _))| v.causality == Causality::Output)
        .map(|(index, scalar): (u32, _)| {
            Element::new("Unknown")
                .with("index", index)
                .with("dependencies", dependencies(scalar))
        })
        .collect()
}

/// Indices of the parameters that determine the scalar's value after initialization.
fn initial_dependencies(scalars: &[Scalar<'_>], (v, element): &Scalar<'_>) -> String {
    (1..)
        .zip(scalars)
        .filter(|(_, (parameter, other))| {
            v.initially_from.contains(&parameter.name)
                && (!(v.array.is_some() && parameter.array.is_some()) || element == other)
        })
        .map(|(index, _): (u32, _)| index.to_string())
        .collect::<Vec<_>>()
        .join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::unit;

    #[derive(Default)]
    struct Model {
        x: f64,
        w: [f64; 2],
        n: i32,
        b: bool,
    }

    const WAYS: Enumeration = Enumeration {
        name: "Way",
        description: "which way & how",
        items: &[("left", "to the left"), ("right", "to the right")],
    };

    type Row = Variable<Model>;

    const VARIABLES: &[Row] = &[
        Row::input("u", |m| &mut m.x).unit(unit::RADIAN).about("in"),
        Row::output("y", |m| &mut m.x)
            .unit(unit::NEWTON)
            .discrete()
            .about("out"),
        Row::tunable("k", 1e-9, |m| &mut m.x)
            .at_least(0.0)
            .about("a < b"),
        Row::fixed_array("w0", &[0.25, -2.0], |m| &mut m.w).about("initial"),
        Row::output_array("w", 2, |m| &mut m.w)
            .initially_from(&["w0"])
            .about("weights"),
        Row::integer("n", 3, (1, 5), |m| &mut m.n).about("count"),
        Row::flag("b", true, |m| &mut m.b).about("whether"),
        Row::choice("way", &WAYS, 2, |m| &mut m.n).about("way"),
    ];

    fn description() -> Element<'static> {
        let subject = Subject {
            name: "Model",
            description: "a \"model\"",
            version: "1.0",
            license: "MIT",
            generation_tool: "test",
            capabilities: &[Capability::CanGetAndSetFMUstate],
            default_experiment: (20.0, 0.001),
            log_categories: &[("logAll", "everything")],
        };
        describe(&subject, VARIABLES)
    }

    #[test]
    fn rows_become_scalar_variables_with_consecutive_references() {
        let description = description();
        let variables: Vec<_> = description
            .list("ModelVariables", "ScalarVariable")
            .collect();
        let names: Vec<_> = variables
            .iter()
            .filter_map(|v| v.attribute("name"))
            .collect();
        assert_eq!(
            names,
            [
                "u", "y", "k", "w0[1]", "w0[2]", "w[1]", "w[2]", "n", "b", "way"
            ]
        );
        for (reference, v) in variables.iter().enumerate() {
            assert_eq!(v.attribute("valueReference"), Some(&*reference.to_string()));
        }
        let start = |i: usize| variables[i].children[0].attribute("start");
        assert_eq!(start(4), Some("-2"));
        assert_eq!(start(2), Some("0.000000001"));
        assert_eq!(start(1), None);
    }

    #[test]
    fn arrays_depend_on_arrays_element_by_element() {
        let description = description();
        let structure = description.child("ModelStructure").unwrap();
        let dependencies: Vec<_> = structure
            .list("InitialUnknowns", "Unknown")
            .map(|u| {
                (
                    u.attribute("index").unwrap(),
                    u.attribute("dependencies").unwrap(),
                )
            })
            .collect();
        assert_eq!(dependencies, [("2", ""), ("6", "4"), ("7", "5")]);
    }

    #[test]
    fn elements_follow_the_order_of_the_schema() {
        let description = description();
        let names: Vec<_> = description
            .children
            .iter()
            .map(|child| child.name)
            .collect();
        assert_eq!(
            names,
            [
                "CoSimulation",
                "UnitDefinitions",
                "TypeDefinitions",
                "LogCategories",
                "DefaultExperiment",
                "ModelVariables",
                "ModelStructure",
            ]
        );
        let xml = description.document().unwrap();
        for part in [
            "displayUnit=\"deg\"",
            "<BaseUnit kg=\"1\" m=\"1\" s=\"-2\"/>",
            "which way &amp; how",
            "canGetAndSetFMUstate=\"true\" canSerializeFMUstate=\"false\"",
        ] {
            assert!(xml.contains(part), "{part} is missing in {xml}");
        }
    }
}
