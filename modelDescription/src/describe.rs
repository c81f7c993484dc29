//! From a model's table to its model description.

use crate::schema::{
    Attributes, BaseUnit, Category, CoSimulation, DefaultExperiment, DisplayUnit, Enumeration,
    Item, LogCategories, ModelDescription, ModelStructure, ModelVariables, ScalarVariable,
    SimpleType, TypeDefinitions, Unit, UnitDefinitions, Unknown, Unknowns,
};
use crate::{Causality, Domain, Info, Variability, Variable, guid};

/// What a model description says beside the variables.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Name of the model, also its `modelIdentifier`: a C identifier.
    pub name: &'a str,
    /// What the model is.
    pub description: &'a str,
    /// Version of the model.
    pub version: &'a str,
    /// SPDX expression.
    pub license: &'a str,
    /// What wrote the FMU.
    pub generation_tool: &'a str,
    /// Stop time and step size of the default experiment (s), which starts at 0.
    pub default_experiment: (f64, f64),
    /// Name and description of each log category.
    pub log_categories: &'a [(&'a str, &'a str)],
}

/// The model description of the model `subject`, whose interface is the table `variables`, and whose
/// C interface has the given capabilities (their `modelIdentifier` is taken from `subject`).
///
/// No output depends on an input within a communication point: every output is latched in
/// `fmi2DoStep`, so `dependencies` is empty, which spares importers false algebraic loops.
pub fn describe<M>(
    subject: &Subject<'_>,
    capabilities: CoSimulation,
    variables: &[Variable<M>],
) -> ModelDescription {
    let infos: Vec<&Info> = variables.iter().map(|v| &v.info).collect();
    let scalars: Vec<(&Info, usize)> = infos
        .iter()
        .flat_map(|v| (0..v.count()).map(move |element| (*v, element)))
        .collect();
    let (stop, step) = subject.default_experiment;
    ModelDescription {
        fmi_version: "2.0".into(),
        model_name: subject.name.into(),
        guid: String::from_utf8_lossy(&guid::guid(subject.name, variables)).into_owned(),
        description: Some(subject.description.into()),
        version: Some(subject.version.into()),
        license: Some(subject.license.into()),
        generation_tool: Some(subject.generation_tool.into()),
        variable_naming_convention: Some("structured".into()),
        co_simulation: Some(CoSimulation {
            model_identifier: subject.name.into(),
            ..capabilities
        }),
        unit_definitions: units(&infos),
        type_definitions: types(&infos),
        log_categories: Some(LogCategories {
            categories: subject.log_categories.iter().map(category).collect(),
        }),
        default_experiment: Some(DefaultExperiment {
            start_time: Some(0.0),
            stop_time: Some(stop),
            tolerance: None,
            step_size: Some(step),
        }),
        model_variables: ModelVariables {
            variables: (0..)
                .zip(&scalars)
                .map(|(reference, (v, element))| scalar(reference, v, *element))
                .collect(),
        },
        model_structure: structure(&scalars),
    }
}

fn category((name, description): &(&str, &str)) -> Category {
    Category {
        name: (*name).into(),
        description: Some((*description).into()),
    }
}

/// The elements made of each variable, each once; nothing where there are none.
fn distinct<T: PartialEq>(variables: &[&Info], of: impl Fn(&Info) -> Option<T>) -> Option<Vec<T>> {
    let mut found = Vec::new();
    for item in variables.iter().filter_map(|v| of(v)) {
        if !found.contains(&item) {
            found.push(item);
        }
    }
    (!found.is_empty()).then_some(found)
}

fn units(variables: &[&Info]) -> Option<UnitDefinitions> {
    distinct(variables, |v| match &v.domain {
        Domain::Real { unit: of, .. } => Some(unit(of)),
        _ => None,
    })
    .map(|units| UnitDefinitions { units })
}

fn unit(unit: &crate::Unit) -> Unit {
    let [kg, m, s, ampere, kelvin, mol, cd, rad] = unit.exponents.map(i32::from);
    let display = |(name, factor): (&str, f64)| DisplayUnit {
        name: name.into(),
        factor,
    };
    Unit {
        name: unit.name.into(),
        base: Some(BaseUnit {
            kg,
            m,
            s,
            ampere,
            kelvin,
            mol,
            cd,
            rad,
        }),
        display: unit.display.map(display).into_iter().collect(),
    }
}

fn types(variables: &[&Info]) -> Option<TypeDefinitions> {
    distinct(variables, |v| match &v.domain {
        Domain::Enumeration { items, .. } => Some(enumeration(items)),
        _ => None,
    })
    .map(|types| TypeDefinitions { types })
}

fn enumeration(enumeration: &crate::Enumeration) -> SimpleType {
    let item = |(value, (name, description)): (i32, &(&str, &str))| Item {
        name: (*name).into(),
        value,
        description: Some((*description).into()),
    };
    SimpleType {
        name: enumeration.name.into(),
        description: Some(enumeration.description.into()),
        enumeration: Some(Enumeration {
            items: (1..).zip(enumeration.items).map(item).collect(),
        }),
    }
}

fn scalar(value_reference: u32, v: &Info, element: usize) -> ScalarVariable {
    let mut scalar = ScalarVariable {
        name: v.element_name(element),
        value_reference,
        description: Some(v.description.into()),
        causality: Some(
            match v.causality {
                Causality::Parameter => "parameter",
                Causality::Input => "input",
                Causality::Output => "output",
            }
            .into(),
        ),
        variability: Some(
            match v.variability {
                Variability::Fixed => "fixed",
                Variability::Tunable => "tunable",
                Variability::Discrete => "discrete",
                Variability::Continuous => "continuous",
            }
            .into(),
        ),
        initial: match v.causality {
            Causality::Parameter => Some("exact".into()),
            Causality::Input => None,
            Causality::Output => Some("calculated".into()),
        },
        real: None,
        integer: None,
        boolean: None,
        string: None,
        enumeration: None,
    };
    match &v.domain {
        Domain::Real {
            start,
            min,
            max,
            unit,
        } => {
            let bound = |bound: &f64| bound.is_finite().then(|| bound.to_string());
            scalar.real = Some(Attributes {
                declared_type: None,
                unit: Some(unit.name.into()),
                display_unit: unit.display.map(|(name, _)| name.into()),
                min: bound(min),
                max: bound(max),
                start: start.of(element).map(|start| start.to_string()),
            });
        }
        Domain::Integer { start, range } => {
            scalar.integer = Some(Attributes {
                min: Some(range.0.to_string()),
                max: Some(range.1.to_string()),
                start: Some(start.to_string()),
                ..Attributes::default()
            });
        }
        Domain::Boolean { start } => {
            scalar.boolean = Some(Attributes {
                start: Some(start.to_string()),
                ..Attributes::default()
            });
        }
        Domain::Enumeration { start, items } => {
            scalar.enumeration = Some(Attributes {
                declared_type: Some(items.name.into()),
                min: Some("1".into()),
                max: Some(items.items.len().to_string()),
                start: Some(start.to_string()),
                ..Attributes::default()
            });
        }
    }
    scalar
}

fn structure(scalars: &[(&Info, usize)]) -> ModelStructure {
    let outputs = || {
        (1..)
            .zip(scalars)
            .filter(|(_, (v, _))| v.causality == Causality::Output)
    };
    let unknowns = |unknowns: Vec<Unknown>| (!unknowns.is_empty()).then_some(Unknowns { unknowns });
    ModelStructure {
        outputs: unknowns(
            outputs()
                .map(|(index, _)| Unknown {
                    index,
                    dependencies: Some(String::new()),
                })
                .collect(),
        ),
        initial_unknowns: unknowns(
            outputs()
                .map(|(index, (v, element))| Unknown {
                    index,
                    dependencies: Some(initial_dependencies(scalars, v, *element)),
                })
                .collect(),
        ),
    }
}

/// Indices of the parameters that the element's value after initialization depends on.
fn initial_dependencies(scalars: &[(&Info, usize)], v: &Info, element: usize) -> String {
    (1..)
        .zip(scalars)
        .filter(|(_, (parameter, other))| {
            v.initially_from.contains(&parameter.name)
                && (!(v.array.is_some() && parameter.array.is_some()) || element == *other)
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

    const WAYS: crate::Enumeration = crate::Enumeration {
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

    fn description() -> ModelDescription {
        let subject = Subject {
            name: "Model",
            description: "a \"model\"",
            version: "1.0",
            license: "MIT",
            generation_tool: "test",
            default_experiment: (20.0, 0.001),
            log_categories: &[("logAll", "everything")],
        };
        describe(&subject, CoSimulation::default(), VARIABLES)
    }

    #[test]
    fn what_is_written_is_read_back_the_same() {
        let written = description();
        let read = ModelDescription::from_xml(&written.to_xml().unwrap()).unwrap();
        assert_eq!(written, read);
    }

    #[test]
    fn rows_become_scalar_variables_with_consecutive_references() {
        let description = description();
        let variables = &description.model_variables.variables;
        let names: Vec<_> = variables.iter().map(|v| v.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "u", "y", "k", "w0[1]", "w0[2]", "w[1]", "w[2]", "n", "b", "way"
            ]
        );
        for (reference, v) in (0..).zip(variables) {
            assert_eq!(v.value_reference, reference);
        }
        let start = |i: usize| variables[i].value().unwrap().1.start.as_deref();
        assert_eq!(start(4), Some("-2"));
        assert_eq!(start(2), Some("0.000000001"));
        assert_eq!(start(1), None);
    }

    #[test]
    fn an_array_depends_on_an_array_element_by_element() {
        let structure = description().model_structure;
        let initial = structure.initial_unknowns.unwrap().unknowns;
        let dependencies: Vec<_> = initial
            .iter()
            .map(|u| (u.index, u.dependencies.as_deref().unwrap()))
            .collect();
        assert_eq!(dependencies, [(2, ""), (6, "4"), (7, "5")]);
    }

    #[test]
    fn elements_stand_in_the_order_of_the_schema() {
        let xml = description().to_xml().unwrap();
        let positions: Vec<_> = [
            "<CoSimulation ",
            "<UnitDefinitions>",
            "<TypeDefinitions>",
            "<LogCategories>",
            "<DefaultExperiment ",
            "<ModelVariables>",
            "<ModelStructure>",
        ]
        .iter()
        .map(|tag| xml.find(tag).expect(tag))
        .collect();
        assert!(positions.is_sorted(), "{xml}");
        assert!(xml.contains("displayUnit=\"deg\""));
        assert!(
            xml.contains("<BaseUnit kg=\"1\" m=\"1\" s=\"-2\"/>"),
            "{xml}"
        );
        assert!(xml.contains("which way &amp; how"));
    }

    #[test]
    fn what_is_no_model_description_is_refused() {
        for text in ["", "<a/>", "<fmiModelDescription", "\u{0}", "{}"] {
            assert!(ModelDescription::from_xml(text).is_err(), "{text}");
        }
    }
}
