//! The model description of FMI 3.0, and terminals.

use anyhow::{Result, bail, ensure};

use crate::exported::ExportedModel;
use crate::variable::{ExportInfo, Variable};
use crate::xml::Element;
use crate::{Causality, FmiVersion, Variability};

/// Name of the independent variable.
const TIME: &str = "time";

/// The variables, with the start values that are in use by default, and the independent variable, with its
/// value reference.
pub(crate) fn variables(model: &ExportedModel) -> Result<Vec<Variable>> {
    ensure!(
        model.variables.iter().all(|v| v.name != TIME),
        "a variable of {} has the name {TIME:?}, which is the name of the independent variable of FMI 3.0; expected another name",
        model.name,
    );
    if let Some(empty) = model.variables.iter().find(|v| model.elements_in_use(v) == 0) {
        bail!(
            "no element of {} is in use; expected a structural parameter that starts at 1 or more in FMI 3.0",
            empty.name
        );
    }
    let variables = model.variables.iter().map(|v| {
        let start = v.start.iter().take(model.elements_in_use(v));
        Variable { start: start.cloned().collect(), ..v.clone() }
    });
    let time = Variable {
        name: TIME.into(),
        reference: model.time as u32,
        description: "Simulation time".into(),
        causality: Causality::Independent,
        variability: Variability::Continuous,
        unit: Some("s".into()),
        exported: ExportInfo { nominal: 1.0, ..ExportInfo::default() },
        ..Variable::default()
    };
    Ok(variables.chain([time]).collect())
}

/// Adds the types of interfaces, with the capabilities of the C interface of `fmu-export`.
pub(crate) fn interfaces(model: &ExportedModel, root: Element<'static>) -> Element<'static> {
    // The attributes that all types have (FMI 3.0.2, section 2.4.2).
    let has_derivatives = model.has_all_derivatives();
    let interface = |name| {
        Element::new(name)
            .with("modelIdentifier", &model.name)
            .with("needsExecutionTool", false)
            .with("canBeInstantiatedOnlyOncePerProcess", model.is_single_instance)
            .with("canGetAndSetFMUState", !model.is_unsaved)
            .with("canSerializeFMUState", !model.is_unserialized)
            .with("providesDirectionalDerivatives", has_derivatives)
            .with("providesAdjointDerivatives", has_derivatives)
            .with("providesPerElementDependencies", false)
            .with("providesEvaluateDiscreteStates", false)
    };
    let exchange = interface("ModelExchange").with("needsCompletedIntegratorStep", false);
    let co_simulation = interface("CoSimulation")
        .with("canHandleVariableCommunicationStepSize", !model.has_fixed_step)
        .with("maxOutputDerivativeOrder", model.max_output_derivative_order())
        .with("providesIntermediateUpdate", model.is_continuous)
        .with("canReturnEarlyAfterIntermediateUpdate", model.is_continuous)
        // In event mode, a step ends at the next sample instant or time event.
        .with("mightReturnEarlyFromDoStep", model.has_events())
        .with("hasEventMode", model.has_events());
    root.holding_all(model.is_for_model_exchange().then_some(exchange))
        .holding_all(model.is_for_co_simulation().then_some(co_simulation))
}

/// Corners of the icon and of the coordinate system that it fills.
const CORNERS: [(&str, i32); 4] = [("x1", -100), ("y1", -100), ("x2", 100), ("y2", 100)];

impl ExportedModel {
    /// Generates `terminalsAndIcons.xml` of FMI 3.0; `None` if there is neither a terminal nor an icon.
    /// Two terminals match if they have members of the same names.
    ///
    /// # Errors
    /// Two members of a terminal have the same name.
    pub fn terminals(&self, has_icon: bool) -> Result<Option<Element<'static>>> {
        let mut terminals: Vec<Element<'static>> = Vec::new();
        for variable in &self.variables {
            let Some((name, member)) = variable.exported.terminal.split_once('.') else { continue };
            let index = match terminals.iter().position(|t| t.attribute("name") == Some(name)) {
                Some(index) => index,
                None => {
                    let terminal = Element::new("Terminal").with("name", name);
                    terminals.push(terminal.with("matchingRule", "plug"));
                    terminals.len() - 1
                }
            };
            let members = &mut terminals[index].children;
            ensure!(
                members.iter().all(|other| other.attribute("memberName") != Some(member)),
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
        CORNERS.iter().fold(element, |element, (name, value)| element.with(name, value))
    };
    Element::new("GraphicalRepresentation")
        .holding(corners("CoordinateSystem").with("suggestedScalingFactorTo_mm", 0.1))
        .holding(corners("Icon"))
}
