//! The model description of FMI 3.0.

use anyhow::{Result, ensure};

use super::{
    Description, FmiVersion, Origin, Type, VariableDescription, list, log_categories, nominal,
    real, state, unit_definition,
};
use crate::unit::Unit;
use crate::xml::Element;
use crate::{Causality, Initial, Variability};

/// Name and unit of the independent variable.
const TIME: (&str, &str) = ("time", "s");

/// A variable and its value reference, which is that of its first scalar.
type Numbered<'a> = (usize, &'a VariableDescription);

impl Description {
    /// Generates the model description of FMI 3.0, in the order of the standard's schema. The value
    /// reference of an array is that of its first element.
    ///
    /// # Errors
    /// A unit is unknown, two enumerations with different items have the same name, or a variable has the
    /// name of the independent variable.
    pub fn to_xml_fmi3(&self, origin: &Origin) -> Result<Element<'static>> {
        let variables: Vec<_> = (self.scalars())
            .filter(|(_, _, element)| *element == 0)
            .map(|(reference, v, _)| (reference, v))
            .collect();
        ensure!(
            self.variables.iter().all(|v| v.name != TIME.0),
            "a variable of {} has the name {:?}, which is that of the independent variable of FMI 3.0; expected another name",
            self.name,
            TIME.0
        );
        let mut units = self.units()?;
        let second = unit_definition(TIME.1)?;
        if !units.contains(&second) {
            units.push(second);
        }
        Ok(self
            .root(FmiVersion::Fmi3, "instantiationToken", origin)
            .holding_all(self.is_for_model_exchange().then(|| self.exchange()))
            .holding(self.slave())
            .listing("UnitDefinitions", units)
            .listing("TypeDefinitions", self.types(enumeration_type)?)
            .holding(log_categories())
            .holding(self.experiment())
            .holding(
                Element::new("ModelVariables")
                    .holding_all(variables.iter().map(|v| self.variable(v)))
                    .holding(self.time()),
            )
            .holding(self.structure(&variables)))
    }

    /// The attributes that all types of interfaces have (FMI 3.0.2, section 2.4.2).
    fn interface_type(&self, name: &'static str, has_derivatives: bool) -> Element<'static> {
        Element::new(name)
            .with("modelIdentifier", &self.name)
            .with("needsExecutionTool", false)
            .with("canBeInstantiatedOnlyOncePerProcess", false)
            .with("canGetAndSetFMUState", true)
            .with("canSerializeFMUState", true)
            .with("providesDirectionalDerivatives", has_derivatives)
            .with("providesAdjointDerivatives", has_derivatives)
            .with("providesPerElementDependencies", false)
            .with("providesEvaluateDiscreteStates", false)
    }

    fn exchange(&self) -> Element<'static> {
        self.interface_type("ModelExchange", self.has_all_derivatives())
            .with("needsCompletedIntegratorStep", false)
    }

    fn slave(&self) -> Element<'static> {
        self.interface_type("CoSimulation", self.has_output_derivatives())
            .with("canHandleVariableCommunicationStepSize", true)
            .with(
                "maxOutputDerivativeOrder",
                self.max_output_derivative_order(),
            )
            .with("providesIntermediateUpdate", self.is_continuous)
            .with("canReturnEarlyAfterIntermediateUpdate", self.is_continuous)
            // In event mode, a step ends at the next sample instant.
            .with("mightReturnEarlyFromDoStep", self.is_sampled)
            .with("hasEventMode", self.is_for_model_exchange())
    }

    fn variable(&self, &(reference, v): &Numbered<'_>) -> Element<'static> {
        let is_intermediate = self.is_continuous
            && v.variability == Variability::Continuous
            && matches!(v.causality, Causality::Input | Causality::Output);
        let element = Element::new(type_name(&v.of_type))
            .with("name", &v.name)
            .with("valueReference", reference)
            .with("description", &v.description)
            .with("causality", v.causality.as_str())
            .with("variability", v.variability.as_str())
            .with_some("initial", v.initial().map(Initial::as_str))
            .with_some("intermediateUpdate", is_intermediate.then_some(true))
            .holding_all(v.dimensions.iter().map(|size| dimension(*size, v.size)));
        let mut in_use = v.of_type.clone();
        in_use.truncate(self.elements(v));
        valued(element, v, &in_use)
    }

    /// The value reference of the independent variable follows those of all scalars.
    fn time_reference(&self) -> usize {
        self.scalars().count()
    }

    /// The independent variable.
    fn time(&self) -> Element<'static> {
        Element::new("Float64")
            .with("name", TIME.0)
            .with("valueReference", self.time_reference())
            .with("description", "Simulation time")
            .with("causality", Causality::Independent.as_str())
            .with("variability", Variability::Continuous.as_str())
            .with("unit", TIME.1)
    }

    /// The model structure (FMI 3.0.2, section 2.4.8).
    ///
    /// Dependencies are always listed, although all are the default: CasADi demands it. All include the
    /// independent variable.
    fn structure(&self, variables: &[Numbered<'_>]) -> Element<'static> {
        let all = |is: fn(&VariableDescription) -> bool| -> Vec<usize> {
            let variables = variables.iter().filter(|(_, v)| is(v));
            let references = variables.map(|(reference, _)| *reference);
            references.chain([self.time_reference()]).collect()
        };
        let all = &all;
        let unknowns = |name, is: fn(&VariableDescription) -> bool| {
            (variables.iter().filter(move |(_, v)| is(v))).map(move |(reference, v)| {
                let known = self.dependencies(&(*reference, v, 0));
                let all = || all(|v| v.causality == Causality::Input || v.is_state());
                unknown(name, *reference, known.unwrap_or_else(all))
            })
        };
        let initial_unknowns =
            (variables.iter().filter(|(_, v)| v.is_initial_unknown())).map(|(reference, v)| {
                let known = self.initial_dependencies(&(*reference, v, 0));
                let all = || all(VariableDescription::is_initially_known);
                unknown("InitialUnknown", *reference, known.unwrap_or_else(all))
            });
        Element::new("ModelStructure")
            .holding_all(unknowns("Output", VariableDescription::is_output))
            .holding_all(unknowns(
                "ContinuousStateDerivative",
                VariableDescription::is_derivative,
            ))
            .holding_all(initial_unknowns)
            .holding_all(unknowns(
                "EventIndicator",
                VariableDescription::is_event_indicator,
            ))
    }
}

fn unknown(name: &'static str, reference: usize, dependencies: Vec<usize>) -> Element<'static> {
    Element::new(name)
        .with("valueReference", reference)
        .with("dependencies", list(&dependencies))
}

fn enumeration_type(
    name: &str,
    description: &str,
    items: Vec<Element<'static>>,
) -> Element<'static> {
    Element::new("EnumerationType")
        .with("name", name)
        .with("description", description)
        .holding_all(items)
}

/// A dimension of constant size, or that of a structural parameter.
fn dimension(size: usize, parameter: Option<usize>) -> Element<'static> {
    let element = Element::new("Dimension");
    match parameter {
        Some(reference) => element.with("valueReference", reference),
        None => element.with("start", size),
    }
}

fn type_name(of_type: &Type) -> &'static str {
    match of_type {
        Type::Real { single: true, .. } => "Float32",
        Type::Real { .. } => "Float64",
        Type::Integer { kind, .. } => kind.as_str(),
        Type::Boolean { .. } => "Boolean",
        Type::String { .. } => "String",
        Type::Binary { .. } => "Binary",
        Type::Enumeration { .. } => "Enumeration",
    }
}

/// The element of a variable with its bounds and start values.
fn valued(element: Element<'static>, v: &VariableDescription, of_type: &Type) -> Element<'static> {
    match of_type {
        Type::Real {
            single,
            min,
            max,
            unit,
            start,
        } => {
            let start: Vec<_> = start.iter().map(|start| real(*start, *single)).collect();
            element
                .with_some("unit", (!unit.is_empty()).then_some(unit))
                .with_some("displayUnit", Unit::display(unit).map(|(name, _)| name))
                .with_some("min", min.is_finite().then(|| real(*min, *single)))
                .with_some("max", max.is_finite().then(|| real(*max, *single)))
                .with_some("nominal", nominal(&v.dynamics))
                .with_some("start", starts(&start))
                .with_some("derivative", state(&v.dynamics))
                .with_some("reinit", v.is_state().then_some(true))
        }
        Type::Integer {
            kind,
            min,
            max,
            start,
        } => {
            let (low, high) = kind.range();
            element
                .with_some("min", (*min > low).then_some(min))
                .with_some("max", (*max < high).then_some(max))
                .with_some("start", starts(start))
        }
        Type::Boolean { start } => element.with_some("start", starts(start)),
        Type::String { start } => element.holding_all(start.iter().map(start_element)),
        Type::Binary { mime_type, start } => {
            let digits = |bytes: &Vec<u8>| bytes.iter().map(|byte| format!("{byte:02x}")).collect();
            let start = start.iter().map(digits);
            element
                .with("mimeType", mime_type)
                .holding_all(start.map(|digits: String| start_element(&digits)))
        }
        Type::Enumeration {
            name, items, start, ..
        } => {
            let values = || items.iter().map(|(value, ..)| *value);
            element
                .with("declaredType", name)
                .with_some("min", values().min())
                .with_some("max", values().max())
                .with_some("start", starts(start))
        }
    }
}

fn start_element(value: &String) -> Element<'static> {
    Element::new("Start").with("value", value)
}

/// The start values of all elements, if there are any.
fn starts<T: ToString>(start: &[T]) -> Option<String> {
    (!start.is_empty()).then(|| list(start))
}
