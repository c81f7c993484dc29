//! Generates the model description from the interface of a model.

use anyhow::{Result, anyhow, ensure};

use crate::table::index;
use crate::unit::{self, Unit};
use crate::xml::Element;
use crate::{Capability, Causality, Initial, LOG_CATEGORIES, Variability};

/// The interface of a model, read from its binary; see [`read_interfaces`](crate::read_interfaces).
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// Name of the model and its `modelIdentifier`: a C identifier.
    pub name: String,
    /// Description of the model.
    pub description: String,
    /// GUID of the interface.
    pub guid: String,
    /// Whether it has a sample time.
    pub is_sampled: bool,
    /// Stop time and step size of the default experiment (s), which starts at 0.
    pub default_experiment: (f64, f64),
    /// Relative tolerance of its integrator; 0 if it has none.
    pub tolerance: f64,
    /// The variables.
    pub variables: Vec<VariableDescription>,
}

/// A variable; see [`Variable`](crate::Variable).
#[derive(Debug, Clone, PartialEq)]
pub struct VariableDescription {
    /// Full name, without an index.
    pub name: String,
    /// A short description.
    pub description: String,
    /// What determines its value.
    pub causality: Causality,
    /// When it may change.
    pub variability: Variability,
    /// Whether the host may set its time derivative.
    pub has_input_derivative: bool,
    /// Whether its derivatives with respect to inputs are known.
    pub has_directional_derivatives: bool,
    /// Numbers of elements of an array; empty for a scalar.
    pub dimensions: Vec<usize>,
    /// Value references of the variables that its value after initialization depends on; of an array,
    /// that of the first element.
    pub initially_from: Vec<usize>,
    /// Type, start values and bounds.
    pub of_type: Type,
}

/// The type of a variable; see [`Domain`](crate::Domain).
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "as in `Domain`")]
pub enum Type {
    Real {
        min: f64,
        max: f64,
        unit: String,
        start: Vec<f64>,
    },
    Integer {
        min: i32,
        max: i32,
        start: Vec<i32>,
    },
    Boolean {
        start: Vec<bool>,
    },
    String {
        start: Vec<String>,
    },
    Enumeration {
        name: String,
        description: String,
        /// Number, name and description of each item.
        items: Vec<(i32, String, String)>,
        start: Vec<i32>,
    },
}

/// Where a model comes from.
#[derive(Debug, Clone, Default)]
pub struct Origin {
    /// Version of the model.
    pub version: String,
    /// Authors, separated by commas.
    pub author: Option<String>,
    /// Copyright notice.
    pub copyright: Option<String>,
    /// SPDX expression.
    pub license: Option<String>,
    /// The tool that generated the FMU.
    pub generation_tool: String,
}

impl VariableDescription {
    /// Number of scalar variables it represents.
    pub fn count(&self) -> usize {
        self.dimensions.iter().product()
    }

    /// The name of an element.
    pub fn element_name(&self, element: usize) -> String {
        format!("{}{}", self.name, index(&self.dimensions, element))
    }

    fn has_start(&self) -> bool {
        match &self.of_type {
            Type::Real { start, .. } => !start.is_empty(),
            Type::Integer { start, .. } | Type::Enumeration { start, .. } => !start.is_empty(),
            Type::Boolean { start } => !start.is_empty(),
            Type::String { start } => !start.is_empty(),
        }
    }

    /// The attribute `initial`; inputs have none.
    fn initial(&self) -> Option<Initial> {
        match Initial::default_for(self.causality, self.variability) {
            Some(Initial::Calculated) if self.has_start() => Some(Initial::Exact),
            initial => initial,
        }
    }
}

/// A scalar variable: its value reference, its variable, and the index of the element.
type Scalar<'a> = (usize, &'a VariableDescription, usize);

impl Description {
    /// The scalar variables; their positions are their value references.
    pub fn scalars(&self) -> impl Iterator<Item = Scalar<'_>> {
        let elements = |v| (0..VariableDescription::count(v)).map(move |element| (v, element));
        let scalars = self.variables.iter().flat_map(elements);
        scalars
            .enumerate()
            .map(|(reference, (v, element))| (reference, v, element))
    }

    /// The variable of a value reference, and the index of the element.
    pub(crate) fn variable_mut(
        &mut self,
        reference: usize,
    ) -> Option<(&mut VariableDescription, usize)> {
        let mut element = reference;
        for variable in &mut self.variables {
            let count = variable.count();
            if element < count {
                return Some((variable, element));
            }
            element -= count;
        }
        None
    }

    /// Generates the model description, in the order of the standard's schema.
    ///
    /// `dependencies` of the outputs are empty: outputs change in `fmi2DoStep` only and never depend on
    /// an input at the same communication point, so importers see no false algebraic loops.
    ///
    /// # Errors
    /// A unit is unknown, or two enumerations with different items have the same name.
    pub fn to_xml(&self, origin: &Origin) -> Result<Element<'static>> {
        let (stop, step) = self.default_experiment;
        let tolerance = (self.tolerance > 0.0).then(|| format!("{:?}", self.tolerance));
        let scalars: Vec<_> = self.scalars().collect();
        let unknowns = |of: &dyn Fn(&Scalar<'_>) -> Option<String>| {
            scalars
                .iter()
                .filter(|(_, v, _)| v.causality == Causality::Output)
                .filter_map(|scalar| Some((scalar.0, of(scalar)?)))
                .map(unknown)
                .collect::<Vec<_>>()
        };
        let initial_unknowns = unknowns(&|scalar @ (_, v, _)| {
            (v.initial() == Some(Initial::Calculated)).then(|| self.initial_dependencies(scalar))
        });
        Ok(Element::new("fmiModelDescription")
            .with("fmiVersion", "2.0")
            .with("modelName", &self.name)
            .with("guid", &self.guid)
            .with("description", &self.description)
            .with_some("author", origin.author.as_ref())
            .with("version", &origin.version)
            .with_some("copyright", origin.copyright.as_ref())
            .with_some("license", origin.license.as_ref())
            .with("generationTool", &origin.generation_tool)
            .with("variableNamingConvention", "structured")
            .holding(self.co_simulation())
            .listing("UnitDefinitions", self.units()?)
            .listing("TypeDefinitions", self.types()?)
            .holding(Element::new("LogCategories").holding_all(LOG_CATEGORIES.map(log_category)))
            .holding(
                Element::new("DefaultExperiment")
                    .with("startTime", 0)
                    .with("stopTime", stop)
                    .with_some("tolerance", tolerance)
                    .with("stepSize", step),
            )
            .holding(Element::new("ModelVariables").holding_all(scalars.iter().map(scalar)))
            .holding(
                Element::new("ModelStructure")
                    .listing("Outputs", unknowns(&|_| Some(String::new())))
                    .listing("InitialUnknowns", initial_unknowns),
            ))
    }

    /// The capabilities of the C interface of `fmu-export`, some of which depend on the variables.
    fn has(&self, capability: Capability) -> bool {
        let any = |has: fn(&VariableDescription) -> bool| self.variables.iter().any(has);
        match capability {
            Capability::CanHandleVariableCommunicationStepSize
            // Memory comes from Rust's allocator, not from the host's callbacks.
            | Capability::CanNotUseMemoryManagementFunctions
            | Capability::CanGetAndSetFMUstate
            | Capability::CanSerializeFMUstate => true,
            Capability::CanInterpolateInputs => any(|v| v.has_input_derivative),
            Capability::ProvidesDirectionalDerivative => any(|v| v.has_directional_derivatives),
            Capability::NeedsExecutionTool
            | Capability::CanRunAsynchronuously
            | Capability::CanBeInstantiatedOnlyOncePerProcess => false,
        }
    }

    fn co_simulation(&self) -> Element<'static> {
        let mut element = Element::new("CoSimulation").with("modelIdentifier", &self.name);
        for &capability in Capability::ALL {
            // The position of this number among the flags.
            if capability == Capability::CanRunAsynchronuously {
                element = element.with("maxOutputDerivativeOrder", 0);
            }
            element = element.with(capability.as_str(), self.has(capability));
        }
        element
    }

    fn units(&self) -> Result<Vec<Element<'static>>> {
        let mut definitions = Vec::new();
        for variable in &self.variables {
            if let Type::Real { unit, .. } = &variable.of_type
                && !unit.is_empty()
            {
                let definition = unit_definition(unit)?;
                if !definitions.contains(&definition) {
                    definitions.push(definition);
                }
            }
        }
        Ok(definitions)
    }

    fn types(&self) -> Result<Vec<Element<'static>>> {
        let mut definitions: Vec<Element<'static>> = Vec::new();
        for variable in &self.variables {
            if let Type::Enumeration {
                name,
                description,
                items,
                ..
            } = &variable.of_type
            {
                let definition = enumeration(name, description, items);
                let other = definitions
                    .iter()
                    .find(|d| d.attribute("name") == Some(name));
                ensure!(
                    other.is_none_or(|other| *other == definition),
                    "two enumerations of {} have the name {name}; expected different names",
                    self.name
                );
                if other.is_none() {
                    definitions.push(definition);
                }
            }
        }
        Ok(definitions)
    }

    /// Indices of the variables that determine the scalar's value after initialization.
    fn initial_dependencies(&self, (_, v, element): &Scalar<'_>) -> String {
        self.scalars()
            .filter(|(reference, other, of_other)| {
                v.initially_from.contains(&(reference - of_other))
                    && (v.dimensions.is_empty()
                        || v.dimensions != other.dimensions
                        || element == of_other)
            })
            .map(|(reference, _, _)| (reference + 1).to_string())
            .collect::<Vec<_>>()
            .join(" ")
    }
}

fn unit_definition(name: &str) -> Result<Element<'static>> {
    let unit = Unit::parse(name).map_err(|error| anyhow!("the unit {name:?}: {error}"))?;
    let base = unit::BASE
        .into_iter()
        .zip(unit.exponents)
        .filter(|(_, exponent)| *exponent != 0)
        .fold(Element::new("BaseUnit"), |base, (name, exponent)| {
            base.with(name, exponent)
        })
        .with_some("factor", (unit.factor != 1.0).then_some(unit.factor))
        .with_some("offset", (unit.offset != 0.0).then_some(unit.offset));
    let display = Unit::display(name).map(|(name, factor)| {
        Element::new("DisplayUnit")
            .with("name", name)
            .with("factor", factor)
    });
    Ok(Element::new("Unit")
        .with("name", name)
        .holding(base)
        .holding_all(display))
}

fn enumeration(name: &str, description: &str, items: &[(i32, String, String)]) -> Element<'static> {
    let item = |(value, name, description): &(i32, String, String)| {
        Element::new("Item")
            .with("name", name)
            .with("value", value)
            .with("description", description)
    };
    Element::new("SimpleType")
        .with("name", name)
        .with("description", description)
        .holding(Element::new("Enumeration").holding_all(items.iter().map(item)))
}

fn log_category((name, description): (&std::ffi::CStr, &str)) -> Element<'static> {
    Element::new("Category")
        .with("name", name.to_string_lossy())
        .with("description", description)
}

fn unknown((reference, dependencies): (usize, String)) -> Element<'static> {
    Element::new("Unknown")
        .with("index", reference + 1)
        .with("dependencies", dependencies)
}

fn scalar((reference, v, element): &Scalar<'_>) -> Element<'static> {
    Element::new("ScalarVariable")
        .with("name", v.element_name(*element))
        .with("valueReference", reference)
        .with("description", &v.description)
        .with("causality", v.causality.as_str())
        .with("variability", v.variability.as_str())
        .with_some("initial", v.initial().map(Initial::as_str))
        .holding(value(&v.of_type, *element))
}

/// The element of the type, with the start value and the bounds.
fn value(of_type: &Type, element: usize) -> Element<'static> {
    match of_type {
        Type::Real {
            min,
            max,
            unit,
            start,
        } => Element::new("Real")
            .with_some("unit", (!unit.is_empty()).then_some(unit))
            .with_some("displayUnit", Unit::display(unit).map(|(name, _)| name))
            .with_some("min", min.is_finite().then_some(*min))
            .with_some("max", max.is_finite().then_some(*max))
            .with_some("start", start.get(element)),
        Type::Integer { min, max, start } => Element::new("Integer")
            .with_some("min", (*min != i32::MIN).then_some(*min))
            .with_some("max", (*max != i32::MAX).then_some(*max))
            .with_some("start", start.get(element)),
        Type::Boolean { start } => Element::new("Boolean").with_some("start", start.get(element)),
        Type::String { start } => Element::new("String").with_some("start", start.get(element)),
        Type::Enumeration {
            name, items, start, ..
        } => {
            let values = || items.iter().map(|(value, ..)| *value);
            Element::new("Enumeration")
                .with("declaredType", name)
                .with_some("min", values().min())
                .with_some("max", values().max())
                .with_some("start", start.get(element))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variable(name: &str, causality: Causality, of_type: Type) -> VariableDescription {
        VariableDescription {
            name: name.into(),
            description: format!("{name} & co"),
            causality,
            variability: match causality {
                Causality::Parameter => Variability::Fixed,
                _ => Variability::Discrete,
            },
            has_input_derivative: false,
            has_directional_derivatives: false,
            dimensions: Vec::new(),
            initially_from: Vec::new(),
            of_type,
        }
    }

    fn real(unit: &str, start: &[f64]) -> Type {
        Type::Real {
            min: 0.0,
            max: f64::INFINITY,
            unit: unit.into(),
            start: start.into(),
        }
    }

    fn way(items: &[(i32, &str)]) -> Type {
        let item = |(value, name): &(i32, &str)| (*value, (*name).into(), String::new());
        Type::Enumeration {
            name: "Way".into(),
            description: "which way".into(),
            items: items.iter().map(item).collect(),
            start: vec![items[0].0],
        }
    }

    fn array(v: VariableDescription, from: &[usize]) -> VariableDescription {
        VariableDescription {
            dimensions: vec![1, 2],
            initially_from: from.into(),
            ..v
        }
    }

    fn model() -> Description {
        use Causality::{Input, Output, Parameter};
        let integer = Type::Integer {
            min: 1,
            max: i32::MAX,
            start: vec![3],
        };
        let text = Type::String {
            start: vec!["a < b".into()],
        };
        Description {
            name: "Model".into(),
            description: "a \"model\"".into(),
            guid: "{1}".into(),
            is_sampled: false,
            default_experiment: (20.0, 0.001),
            tolerance: 1e-11,
            variables: vec![
                variable("u", Input, real("rad", &[0.0])),
                variable("y", Output, real("mN", &[])),
                variable("held", Output, real("1", &[1e-9])),
                array(variable("w0", Parameter, real("degC", &[0.25, 2.0])), &[]),
                array(variable("w", Output, real("1", &[])), &[3]),
                variable("n", Parameter, integer),
                variable("b", Parameter, Type::Boolean { start: vec![true] }),
                variable("file", Parameter, text),
                variable("way", Parameter, way(&[(4, "left"), (2, "right")])),
            ],
        }
    }

    fn xml(model: &Description) -> Element<'static> {
        model.to_xml(&Origin::default()).unwrap()
    }

    #[test]
    fn elements_of_arrays_are_scalar_variables_with_consecutive_references() {
        let description = xml(&model());
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
                "u", "y", "held", "w0[1,1]", "w0[1,2]", "w[1,1]", "w[1,2]", "n", "b", "file", "way"
            ]
        );
        for (reference, v) in variables.iter().enumerate() {
            assert_eq!(v.attribute("valueReference"), Some(&*reference.to_string()));
        }
        let start = |i: usize| variables[i].children[0].attribute("start");
        let starts = [1, 2, 4, 9].map(start);
        assert_eq!(
            starts,
            [None, Some("0.000000001"), Some("2"), Some("a < b")]
        );
        let initial = |i: usize| variables[i].attribute("initial");
        let initials = [0, 1, 2, 3].map(initial);
        assert_eq!(
            initials,
            [None, Some("calculated"), Some("exact"), Some("exact")]
        );
    }

    #[test]
    fn arrays_depend_on_arrays_element_by_element() {
        let description = xml(&model());
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
        let description = xml(&model());
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
            "<DefaultExperiment startTime=\"0\" stopTime=\"20\" tolerance=\"1e-11\" stepSize=\"0.001\"/>",
            "<BaseUnit kg=\"1\" m=\"1\" s=\"-2\" factor=\"0.001\"/>",
            "<BaseUnit K=\"1\" offset=\"273.15\"/>",
            "way &amp; co",
            "<Enumeration declaredType=\"Way\" min=\"2\" max=\"4\" start=\"4\"/>",
            "<Integer min=\"1\" start=\"3\"/>",
            "canGetAndSetFMUstate=\"true\" canSerializeFMUstate=\"true\" providesDirectionalDerivative=\"false\"",
        ] {
            assert!(xml.contains(part), "{part} is missing in {xml}");
        }
    }

    #[test]
    fn enumerations_of_one_name_have_the_same_items() {
        let mut model = model();
        let same = way(&[(4, "left"), (2, "right")]);
        let other = way(&[(1, "left"), (2, "right")]);
        model
            .variables
            .push(variable("back", Causality::Parameter, same));
        assert_eq!(xml(&model).list("TypeDefinitions", "SimpleType").count(), 1);
        model
            .variables
            .push(variable("again", Causality::Parameter, other));
        let error = model.to_xml(&Origin::default()).unwrap_err().to_string();
        assert!(error.contains("Way"), "{error}");
    }
}
