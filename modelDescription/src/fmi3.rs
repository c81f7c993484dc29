//! The model description of FMI 3.0, and terminals.

use anyhow::{Result, ensure};

use crate::describe::{Description, Entry, attributes, list, text, typed};
use crate::xml::Element;
use crate::{Causality, Dynamics, FmiVersion, Type, Variability};

/// Name and unit of the independent variable.
pub(crate) const TIME: (&str, &str) = ("time", "s");

/// The variables; an array has the value reference of its first element.
pub(crate) fn entries(model: &Description) -> Result<Vec<Entry<'_>>> {
    ensure!(
        model.variables.iter().all(|v| v.name != TIME.0),
        "a variable of {} has the name {:?}, which is that of the independent variable of FMI 3.0; expected another name",
        model.name,
        TIME.0
    );
    let variables = model.variables.iter();
    Ok(variables.map(|v| Entry { v, element: 0 }).collect())
}

/// Adds the types of interfaces, with the capabilities of the C interface of `fmu-export`.
pub(crate) fn interfaces(model: &Description, root: Element<'static>) -> Element<'static> {
    // The attributes that all types have (FMI 3.0.2, section 2.4.2).
    let interface = |name, has_derivatives: bool| {
        Element::new(name)
            .with("modelIdentifier", &model.name)
            .with("needsExecutionTool", false)
            .with("canBeInstantiatedOnlyOncePerProcess", false)
            .with("canGetAndSetFMUState", true)
            .with("canSerializeFMUState", true)
            .with("providesDirectionalDerivatives", has_derivatives)
            .with("providesAdjointDerivatives", has_derivatives)
            .with("providesPerElementDependencies", false)
            .with("providesEvaluateDiscreteStates", false)
    };
    let exchange = interface("ModelExchange", model.has_all_derivatives())
        .with("needsCompletedIntegratorStep", false);
    let co_simulation = interface("CoSimulation", model.has_output_derivatives())
        .with("canHandleVariableCommunicationStepSize", true)
        .with(
            "maxOutputDerivativeOrder",
            model.max_output_derivative_order(),
        )
        .with("providesIntermediateUpdate", model.is_continuous)
        .with("canReturnEarlyAfterIntermediateUpdate", model.is_continuous)
        // In event mode, a step ends at the next sample instant.
        .with("mightReturnEarlyFromDoStep", model.is_sampled)
        .with("hasEventMode", model.is_for_model_exchange());
    root.holding_all(model.is_for_model_exchange().then_some(exchange))
        .holding(co_simulation)
}

/// `ModelVariables`, with the independent variable.
pub(crate) fn variables(model: &Description, entries: &[Entry<'_>]) -> Element<'static> {
    let time = Element::new("Float64")
        .with("name", TIME.0)
        .with("valueReference", time_reference(model))
        .with("description", "Simulation time")
        .with("causality", Causality::Independent.as_str())
        .with("variability", Variability::Continuous.as_str())
        .with("unit", TIME.1);
    Element::new("ModelVariables")
        .holding_all(entries.iter().map(|entry| variable(model, entry)))
        .holding(time)
}

fn variable(model: &Description, entry: &Entry<'_>) -> Element<'static> {
    let v = entry.v;
    let is_intermediate = model.is_continuous
        && v.variability == Variability::Continuous
        && matches!(v.causality, Causality::Input | Causality::Output);
    // A dimension of constant size, or the size of a structural parameter.
    let dimension = |size: &usize| match v.exported.size {
        Some(reference) => Element::new("Dimension").with("valueReference", reference),
        None => Element::new("Dimension").with("start", size),
    };
    let starts = v.start.iter().take(model.elements(v)).map(text);
    let has_elements = matches!(v.of_type, Type::String | Type::Binary);
    let (elements, start) = match has_elements || v.start.is_empty() {
        true => (starts.collect(), None),
        false => (Vec::new(), Some(list(starts))),
    };
    let state = match v.exported.dynamics {
        Dynamics::Derivative { of } => Some(of),
        _ => None,
    };
    let element = attributes(Element::new(v.of_type.as_str()), entry, &v.name)
        .with_some("intermediateUpdate", is_intermediate.then_some(true))
        .holding_all(v.dimensions.iter().map(dimension));
    let start_element = |value: String| Element::new("Start").with("value", value);
    typed(element, v, v.of_type.range(), start, state)
        .holding_all(elements.into_iter().map(start_element))
}

/// The value reference of the independent variable comes after all scalars.
pub(crate) fn time_reference(model: &Description) -> usize {
    model.scalars().count()
}

/// Corners of the icon and of the coordinate system that it fills.
const CORNERS: [(&str, i32); 4] = [("x1", -100), ("y1", -100), ("x2", 100), ("y2", 100)];

impl Description {
    /// Generates `terminalsAndIcons.xml` of FMI 3.0; `None` if there is neither a terminal nor an icon.
    /// Two terminals match if they have members of the same names.
    ///
    /// # Errors
    /// Two members of a terminal have the same name.
    pub fn terminals(&self, has_icon: bool) -> Result<Option<Element<'static>>> {
        let mut terminals: Vec<Element<'static>> = Vec::new();
        for variable in &self.variables {
            let Some((name, member)) = variable.exported.terminal.split_once('.') else {
                continue;
            };
            let index = match terminals
                .iter()
                .position(|t| t.attribute("name") == Some(name))
            {
                Some(index) => index,
                None => {
                    let terminal = Element::new("Terminal").with("name", name);
                    terminals.push(terminal.with("matchingRule", "plug"));
                    terminals.len() - 1
                }
            };
            let members = &mut terminals[index].children;
            ensure!(
                members
                    .iter()
                    .all(|other| other.attribute("memberName") != Some(member)),
                "two variables of {} are the member {member} of the terminal {name}; expected different members",
                self.name
            );
            members.push(
                Element::new("TerminalMemberVariable")
                    .with("variableName", &variable.name)
                    .with("memberName", member)
                    .with("variableKind", "signal"),
            );
        }
        let is_empty = terminals.is_empty() && !has_icon;
        let root = Element::new("fmiTerminalsAndIcons")
            .with("fmiVersion", FmiVersion::Fmi3.as_str())
            .holding_all(has_icon.then(graphics))
            .listing("Terminals", terminals);
        Ok((!is_empty).then_some(root))
    }
}

fn graphics() -> Element<'static> {
    let corners = |name| {
        let element = Element::new(name);
        CORNERS
            .iter()
            .fold(element, |element, (name, value)| element.with(name, value))
    };
    Element::new("GraphicalRepresentation")
        .holding(corners("CoordinateSystem").with("suggestedScalingFactorTo_mm", 0.1))
        .holding(corners("Icon"))
}
