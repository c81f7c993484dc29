//! The model description of FMI 2.0.

use crate::describe::{Description, Entry, attributes, text, typed};
use crate::variable::Variable;
use crate::xml::Element;
use crate::{Causality, Dynamics, FmiVersion, Type, Value};

/// The scalar variables that FMI 2.0 can express, of arrays the elements that are in use by default.
pub(crate) fn entries(model: &Description) -> Vec<Entry<'_>> {
    let variables = model.variables.iter().filter(|v| can_express(v));
    variables
        .flat_map(|v| (0..model.elements(v)).map(move |element| Entry { v, element }))
        .collect()
}

/// Whether a variable is neither a structural parameter nor binary, and its start values and one of the
/// values that it may have are integers of 32 bits.
fn can_express(v: &Variable) -> bool {
    let (low, high) = Type::Int32.range();
    let whole = |value: &Option<Value>| value.as_ref().and_then(Value::as_whole);
    let is_allowed =
        whole(&v.min).is_none_or(|min| min <= high) && whole(&v.max).is_none_or(|max| max >= low);
    v.causality != Causality::StructuralParameter
        && v.of_type != Type::Binary
        && is_allowed
        && (v.start.iter().filter_map(Value::as_whole)).all(|n| (low..=high).contains(&n))
}

/// Adds the types of interfaces, with the capabilities of the C interface of `fmu-export`. Memory comes from
/// Rust's allocator, not from the callbacks of the host.
pub(crate) fn interfaces(
    model: &Description,
    entries: &[Entry<'_>],
    root: Element<'static>,
) -> Element<'static> {
    let event_indicators = entries.iter().filter(|entry| entry.v.is_event_indicator());
    let exchange = Element::new("ModelExchange")
        .with("modelIdentifier", &model.name)
        .with("needsExecutionTool", false)
        .with("completedIntegratorStepNotNeeded", true)
        .with("canBeInstantiatedOnlyOncePerProcess", false)
        .with("canNotUseMemoryManagementFunctions", true)
        .with("canGetAndSetFMUstate", true)
        .with("canSerializeFMUstate", true)
        .with("providesDirectionalDerivative", model.has_all_derivatives());
    let interpolates = model
        .variables
        .iter()
        .any(|v| v.exported.has_input_derivative);
    let co_simulation = Element::new("CoSimulation")
        .with("modelIdentifier", &model.name)
        .with("needsExecutionTool", false)
        .with("canHandleVariableCommunicationStepSize", true)
        .with("canInterpolateInputs", interpolates)
        .with(
            "maxOutputDerivativeOrder",
            model.max_output_derivative_order(),
        )
        .with("canRunAsynchronuously", false)
        .with("canBeInstantiatedOnlyOncePerProcess", false)
        .with("canNotUseMemoryManagementFunctions", true)
        .with("canGetAndSetFMUstate", true)
        .with("canSerializeFMUstate", true)
        .with(
            "providesDirectionalDerivative",
            model.has_output_derivatives(),
        );
    let is_for_exchange = model.is_for_model_exchange();
    root.with_some(
        "numberOfEventIndicators",
        is_for_exchange.then(|| event_indicators.count()),
    )
    .holding_all(is_for_exchange.then_some(exchange))
    .holding(co_simulation)
}

/// The position of a scalar among the entries, from 1.
pub(crate) fn index(reference: usize, entries: &[Entry<'_>]) -> Option<usize> {
    let found = entries.binary_search_by_key(&reference, Entry::reference);
    found.ok().map(|position| position + 1)
}

/// `ModelVariables`
pub(crate) fn variables(entries: &[Entry<'_>]) -> Element<'static> {
    let variable = |entry: &Entry<'_>| {
        let Entry { v, element } = *entry;
        let of_type = Element::new(v.of_type.name(FmiVersion::Fmi2));
        let start = v.start.get(element).map(text);
        let state = match v.exported.dynamics {
            Dynamics::Derivative { of } => index(of + element, entries),
            _ => None,
        };
        let name = v.element_name(&v.name, element);
        attributes(Element::new("ScalarVariable"), entry, &name).holding(typed(
            of_type,
            v,
            Type::Int32.range(),
            start,
            state,
        ))
    };
    Element::new("ModelVariables").holding_all(entries.iter().map(variable))
}
