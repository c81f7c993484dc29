//! The model description of FMI 2.0.

use crate::exported::ExportedModel;
use crate::variable::{ExportInfo, Variable};
use crate::xml::Element;
use crate::{Causality, Dynamics, Initial, Type, Value, Variability};

/// The scalar variables that FMI 2.0 can express, of arrays the elements that are in use by default.
pub(crate) fn variables(model: &ExportedModel) -> Vec<Variable> {
    let is_in = |v: &&Variable| v.causality != Causality::StructuralParameter && lacks(v).is_none();
    let variables = model.variables.iter().filter(is_in);
    variables
        .flat_map(|v| (0..model.elements_in_use(v)).map(move |element| scalar(model, v, element)))
        .collect()
}

/// The variables for the other names of a variable. They are its aliases, variables with the same value reference, of
/// which FMI 2.0 allows only one to be set and to have a start value (FMI 2.0.5, section 2.2.7). This one gets the first
/// former name, so that all that hosts have set by this name they still can; it is then the variable itself.
pub(crate) fn take_aliases(v: &mut Variable) -> Vec<Variable> {
    let mut names = std::mem::take(&mut v.aliases);
    let is_set = !v.start.is_empty() && v.variability != Variability::Constant;
    let name = v.name.clone();
    let former = format!("{} (former name of {name})", v.description);
    let by = match v.causality {
        Causality::Input | Causality::Parameter => {
            names.first().map(|by| format!(" (set as {by})"))
        }
        _ => None,
    };
    let alias = Variable {
        causality: match v.causality {
            Causality::Input => Causality::Local,
            Causality::Parameter => Causality::CalculatedParameter,
            causality => causality,
        },
        initial: if is_set { Some(Initial::Calculated) } else { v.initial },
        start: if is_set { Vec::new() } else { v.start.clone() },
        exported: ExportInfo {
            dynamics: Dynamics::Algebraic,
            initially_from: match is_set {
                true => Some(vec![v.reference as usize]),
                false => v.exported.initially_from.clone(),
            },
            depends_on: match v.exported.dynamics {
                Dynamics::State => vec![v.reference as usize],
                _ => v.exported.depends_on.clone(),
            },
            ..v.exported.clone()
        },
        ..v.clone()
    };
    if let Some(first) = names.first_mut().filter(|_| is_set) {
        v.name = std::mem::replace(first, name.clone());
        v.description.clone_from(&former);
    }
    let others = names.into_iter().map(|other| {
        let description = match other == name {
            true => format!("{}{}", alias.description, by.as_deref().unwrap_or_default()),
            false => former.clone(),
        };
        Variable { name: other, description, ..alias.clone() }
    });
    others.collect()
}

/// Why FMI 2.0 cannot express a variable: it is a clock, or changes at the ticks of one, it is binary, or a start value or all values that it may have are
/// beyond 32 bits.
pub(crate) fn lacks(v: &Variable) -> Option<&'static str> {
    let (low, high) = Type::Int32.range();
    let whole = |value: &Option<Value>| value.as_ref().and_then(Value::as_whole);
    let is_allowed =
        whole(&v.min).is_none_or(|min| min <= high) && whole(&v.max).is_none_or(|max| max >= low);
    let mut starts = v.start.iter().filter_map(Value::as_whole);
    match v.of_type {
        Type::Clock => Some("a Clock"),
        _ if v.is_of_ticks() => Some("changes at the ticks of a Clock"),
        Type::Binary => Some("a Binary"),
        _ if is_allowed && starts.all(|n| (low..=high).contains(&n)) => None,
        _ => Some("beyond the 32 bits of an Integer"),
    }
}

/// An element of a variable. It depends on the elements of arrays of other dimensions, and on the same element of an
/// array of the same ones. A type of whole numbers other than Integer has its bounds.
fn scalar(model: &ExportedModel, v: &Variable, element: usize) -> Variable {
    let from = |other: &&Variable| {
        let references = v.exported.initially_from.as_deref();
        references.is_some_and(|all| all.contains(&(other.reference as usize)))
    };
    let elements_of = |other: &Variable| {
        let first = other.reference as usize;
        match v.dimensions.is_empty() || v.dimensions != other.dimensions {
            true => first..first + model.elements_in_use(other),
            false => first + element..first + element + 1,
        }
    };
    let ((low, high), (least, most)) = (Type::Int32.range(), v.of_type.range());
    let whole = |bound: &Option<Value>, of_type| {
        let bound = bound.as_ref().and_then(Value::as_whole);
        Some(bound.unwrap_or(of_type))
    };
    let value = |bound| Value::whole(v.of_type, bound);
    let (min, max) = match v.of_type.is_integer() {
        true => (
            whole(&v.min, least).filter(|min| *min > low).and_then(value),
            whole(&v.max, most).filter(|max| *max < high).and_then(value),
        ),
        false => (v.min.clone(), v.max.clone()),
    };
    Variable {
        name: v.element_name(&v.name, element),
        aliases: v.aliases.iter().map(|alias| v.element_name(alias, element)).collect(),
        reference: v.reference + element as u32,
        dimensions: Vec::new(),
        min,
        max,
        start: v.start.get(element).cloned().into_iter().collect(),
        exported: ExportInfo {
            dynamics: match v.exported.dynamics {
                Dynamics::Derivative { of } => Dynamics::Derivative { of: of + element },
                other => other,
            },
            initially_from: (v.exported.initially_from.as_ref()).map(|_| {
                let all = model.variables.iter().filter(from);
                all.flat_map(elements_of).collect()
            }),
            ..v.exported.clone()
        },
        ..v.clone()
    }
}

/// Adds the types of interfaces, with the capabilities of the C interface of `fmu-export`. Memory comes from
/// Rust's allocator, not from the callbacks of the host. `variables` are the scalar variables that FMI 2.0 lists.
pub(crate) fn interfaces(
    model: &ExportedModel,
    variables: &[Variable],
    root: Element<'static>,
) -> Element<'static> {
    let event_indicators = variables.iter().filter(|v| v.is_event_indicator());
    let interface = |name| {
        let identified = Element::new(name).with("modelIdentifier", &model.name);
        identified.with("needsExecutionTool", false)
    };
    let common = |interface: Element<'static>| {
        interface
            .with("canBeInstantiatedOnlyOncePerProcess", model.is_single_instance)
            .with("canNotUseMemoryManagementFunctions", true)
            .with("canGetAndSetFMUstate", !model.is_unsaved)
            .with("canSerializeFMUstate", !model.is_unserialized)
            .with("providesDirectionalDerivative", model.has_all_derivatives())
    };
    let exchange = interface("ModelExchange").with("completedIntegratorStepNotNeeded", true);
    // A host that reads `canInterpolateInputs` may set the derivatives of all continuous inputs.
    let is_continuous_input =
        |v: &&Variable| v.causality == Causality::Input && v.variability == Variability::Continuous;
    let mut inputs = model.variables.iter().filter(is_continuous_input).peekable();
    let interpolates = inputs.peek().is_some() && inputs.all(|v| v.exported.has_input_derivative);
    let co_simulation = interface("CoSimulation")
        .with("canHandleVariableCommunicationStepSize", !model.has_fixed_step)
        .with("canInterpolateInputs", interpolates)
        .with("maxOutputDerivativeOrder", model.max_output_derivative_order())
        .with("canRunAsynchronuously", false);
    let is_for_exchange = model.is_for_model_exchange();
    root.with_some("numberOfEventIndicators", is_for_exchange.then(|| event_indicators.count()))
        .holding_all(is_for_exchange.then(|| common(exchange)))
        .holding_all(model.is_for_co_simulation().then(|| common(co_simulation)))
}
