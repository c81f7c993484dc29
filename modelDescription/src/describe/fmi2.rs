//! The model description of FMI 2.0.

use anyhow::Result;

use super::{
    Description, FmiVersion, Origin, Scalar, Type, VariableDescription, list, log_categories,
    nominal, real, state,
};
use crate::unit::Unit;
use crate::xml::Element;
use crate::{Capability, Causality, Initial, IntegerKind};

impl Description {
    /// Generates the model description of FMI 2.0, in the order of the standard's schema. Variables that
    /// FMI 2.0 does not have are left out, see [`VariableDescription::is_in_fmi2`], and the elements of
    /// arrays that are not in use by default.
    ///
    /// # Errors
    /// A unit is unknown, or two enumerations with different items have the same name.
    pub fn to_xml(&self, origin: &Origin) -> Result<Element<'static>> {
        let is_listed =
            |(_, v, element): &Scalar<'_>| v.is_in_fmi2() && *element < self.elements(v);
        let scalars: Vec<_> = self.scalars().filter(is_listed).collect();
        let event_indicators = scalars.iter().filter(|(_, v, _)| v.is_event_indicator());
        let event_indicators = self
            .is_for_model_exchange()
            .then(|| event_indicators.count());
        Ok(self
            .root(FmiVersion::Fmi2, "guid", origin)
            .with_some("numberOfEventIndicators", event_indicators)
            .holding_all(self.model_exchange())
            .holding(self.co_simulation())
            .listing("UnitDefinitions", self.units()?)
            .listing("TypeDefinitions", self.types(simple_type)?)
            .holding(log_categories())
            .holding(self.experiment())
            .holding(
                Element::new("ModelVariables")
                    .holding_all(scalars.iter().map(|of| scalar(of, &scalars))),
            )
            .holding(self.model_structure(&scalars)))
    }

    fn model_structure(&self, scalars: &[Scalar<'_>]) -> Element<'static> {
        let unknowns = |is: fn(&VariableDescription) -> bool| {
            let unknowns = scalars.iter().filter(move |(_, v, _)| is(v));
            unknowns
                .map(|scalar| unknown(scalar, self.dependencies(scalar), scalars))
                .collect()
        };
        let initial_unknowns = (scalars.iter())
            .filter(|(_, v, _)| v.is_initial_unknown())
            .map(|scalar| unknown(scalar, Some(self.initially_from(scalar)), scalars))
            .collect();
        Element::new("ModelStructure")
            .listing("Outputs", unknowns(VariableDescription::is_output))
            .listing("Derivatives", unknowns(VariableDescription::is_derivative))
            .listing("InitialUnknowns", initial_unknowns)
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
            Capability::ProvidesDirectionalDerivative => {
                self.has_output_derivatives()
            }
            Capability::NeedsExecutionTool
            | Capability::CanRunAsynchronuously
            | Capability::CanBeInstantiatedOnlyOncePerProcess => false,
        }
    }

    fn model_exchange(&self) -> Option<Element<'static>> {
        let element = Element::new("ModelExchange")
            .with("modelIdentifier", &self.name)
            .with("needsExecutionTool", false)
            .with("completedIntegratorStepNotNeeded", true)
            .with("canBeInstantiatedOnlyOncePerProcess", false)
            .with("canNotUseMemoryManagementFunctions", true)
            .with("canGetAndSetFMUstate", true)
            .with("canSerializeFMUstate", true)
            .with("providesDirectionalDerivative", self.has_all_derivatives());
        self.is_for_model_exchange().then_some(element)
    }

    fn co_simulation(&self) -> Element<'static> {
        let mut element = Element::new("CoSimulation").with("modelIdentifier", &self.name);
        for &capability in Capability::ALL {
            // The position of this number among the flags.
            if capability == Capability::CanRunAsynchronuously {
                element = element.with(
                    "maxOutputDerivativeOrder",
                    self.max_output_derivative_order(),
                );
            }
            element = element.with(capability.as_str(), self.has(capability));
        }
        element
    }

    /// Value references of the scalars that determine a scalar's value after the initialization: those of
    /// an array of the same dimensions, element by element. If they are unknown, all candidates are listed,
    /// since CasADi requires a list.
    fn initially_from(&self, scalar: &Scalar<'_>) -> Vec<usize> {
        let (_, v, element) = *scalar;
        let variables = self.initial_dependencies(scalar);
        let is_used = |(reference, other, of_other): &Scalar<'_>| match &variables {
            None => other.is_initially_known(),
            Some(variables) => {
                variables.contains(&(reference - of_other))
                    && (v.dimensions.is_empty()
                        || v.dimensions != other.dimensions
                        || element == *of_other)
            }
        };
        self.scalars().filter(is_used).map(|s| s.0).collect()
    }
}

impl VariableDescription {
    /// Whether FMI 2.0 can express the variable: it is neither a structural parameter nor binary, and its
    /// start values and one of the values that it may have are integers of 32 bits.
    pub fn is_in_fmi2(&self) -> bool {
        match &self.of_type {
            _ if self.causality == Causality::StructuralParameter => false,
            Type::Integer {
                min, max, start, ..
            } => {
                let (low, high) = IntegerKind::Int32.range();
                *min <= high && low <= *max && start.iter().all(|n| (low..=high).contains(n))
            }
            Type::Binary { .. } => false,
            _ => true,
        }
    }
}

/// The position of a scalar among those that are listed, from 1.
fn index(reference: usize, scalars: &[Scalar<'_>]) -> Option<usize> {
    let found = scalars.binary_search_by_key(&reference, |scalar| scalar.0);
    found.ok().map(|position| position + 1)
}

/// An unknown and the scalars it depends on, by index.
fn unknown(
    (reference, ..): &Scalar<'_>,
    dependencies: Option<Vec<usize>>,
    scalars: &[Scalar<'_>],
) -> Element<'static> {
    let indices: Option<Vec<_>> =
        dependencies.map(|of| of.iter().filter_map(|&r| index(r, scalars)).collect());
    Element::new("Unknown")
        .with_some("index", index(*reference, scalars))
        .with_some("dependencies", indices.map(|indices| list(&indices)))
}

fn scalar((reference, v, element): &Scalar<'_>, scalars: &[Scalar<'_>]) -> Element<'static> {
    let state = state(&v.dynamics).and_then(|state| index(state + element, scalars));
    Element::new("ScalarVariable")
        .with("name", v.element_name(*element))
        .with("valueReference", reference)
        .with("description", &v.description)
        .with("causality", v.causality.as_str())
        .with("variability", v.variability.as_str())
        .with_some("initial", v.initial().map(Initial::as_str))
        .holding_all(value(v, state, *element))
}

/// The element of the type, with the start value and the bounds; `state` is the index of the state of a
/// derivative.
fn value(
    v: &VariableDescription,
    state: Option<usize>,
    element: usize,
) -> Option<Element<'static>> {
    Some(match &v.of_type {
        Type::Real {
            single,
            min,
            max,
            unit,
            start,
        } => Element::new("Real")
            .with_some("unit", (!unit.is_empty()).then_some(unit))
            .with_some("displayUnit", Unit::display(unit).map(|(name, _)| name))
            .with_some("min", min.is_finite().then(|| real(*min, *single)))
            .with_some("max", max.is_finite().then(|| real(*max, *single)))
            .with_some("nominal", nominal(&v.dynamics))
            .with_some(
                "start",
                start.get(element).map(|start| real(*start, *single)),
            )
            .with_some("derivative", state)
            .with_some("reinit", v.is_state().then_some(true)),
        Type::Integer {
            min, max, start, ..
        } => {
            let (low, high) = IntegerKind::Int32.range();
            Element::new("Integer")
                .with_some("min", (*min > low).then_some(*min))
                .with_some("max", (*max < high).then_some(*max))
                .with_some("start", start.get(element))
        }
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
        Type::Binary { .. } => return None,
    })
}

/// The definition of an enumeration.
fn simple_type(name: &str, description: &str, items: Vec<Element<'static>>) -> Element<'static> {
    Element::new("SimpleType")
        .with("name", name)
        .with("description", description)
        .holding(Element::new("Enumeration").holding_all(items))
}
