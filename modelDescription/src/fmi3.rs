//! The model description of FMI 3.0.

use anyhow::{Result, bail, ensure};

use crate::exported::ExportedModel;
use crate::variable::{ExportInfo, Variable};
use crate::xml::Element;
use crate::{Causality, ClockType, Type, Variability};

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
    let clocks = model.variables.iter().filter(|v| v.of_type == Type::Clock);
    for clock in clocks.filter(|_| model.has_sample_clocks) {
        let named = model.variables.iter().filter(|v| v.names().any(|name| name == clock.name));
        ensure!(
            named.count() == 1,
            "a variable of {} has the name {:?}, which is the name of the clock of its samples in scheduled execution; expected another name",
            model.name,
            clock.name
        );
    }
    let mut clocks = 0;
    let variables = model.variables.iter().map(|v| {
        let start = v.start.iter().take(model.elements_in_use(v));
        let mut variable = Variable { start: start.cloned().collect(), ..v.clone() };
        // Scheduled execution demands priorities of input clocks: the first is the highest.
        if let Some(clock) = variable.clock.as_mut().filter(|_| v.causality == Causality::Input) {
            let order = Some(clocks).filter(|_| model.is_for_scheduled_execution());
            clock.priority = clock.priority.or(order);
            clocks += 1;
        }
        variable
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

/// Adds what says when a clock ticks.
pub(crate) fn with_clock(element: Element<'static>, clock: &ClockType) -> Element<'static> {
    let known = clock.interval;
    let shift = known.and(Some(clock.shift).filter(|shift| *shift != 0.0));
    let counter = |time: f64| clock.counter(time).filter(|_| clock.supports_fraction);
    element
        .with_some("canBeDeactivated", clock.can_be_deactivated.then_some(true))
        .with_some("priority", clock.priority)
        .with("intervalVariability", clock.interval_variability.keyword())
        .with_some("intervalDecimal", known)
        .with_some("shiftDecimal", shift)
        .with_some("supportsFraction", clock.supports_fraction.then_some(true))
        .with_some("resolution", clock.resolution)
        .with_some("intervalCounter", known.and_then(counter))
        .with_some("shiftCounter", shift.and_then(counter))
}

/// Adds the types of interfaces, with the capabilities of the C interface of `fmu-export`.
pub(crate) fn interfaces(model: &ExportedModel, root: Element<'static>) -> Element<'static> {
    // The attributes that all types have (FMI 3.0.2, section 2.4.2).
    let (has_derivatives, has_clocks) = (model.has_all_derivatives(), model.has_clocks());
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
    };
    let with_events = |name| interface(name).with("providesEvaluateDiscreteStates", has_clocks);
    let exchange = with_events("ModelExchange").with("needsCompletedIntegratorStep", false);
    let co_simulation = with_events("CoSimulation")
        .with("canHandleVariableCommunicationStepSize", !model.has_fixed_step)
        .with("maxOutputDerivativeOrder", model.max_output_derivative_order())
        .with("providesIntermediateUpdate", model.is_continuous)
        .with("canReturnEarlyAfterIntermediateUpdate", model.is_continuous)
        // In event mode, a step ends at the next sample instant or time event; the host knows when clocks tick.
        .with("mightReturnEarlyFromDoStep", model.has_events() && !model.is_clocked)
        .with("hasEventMode", model.has_events());
    let scheduled = interface("ScheduledExecution");
    root.holding_all(model.is_for_model_exchange().then_some(exchange))
        .holding_all(model.is_for_co_simulation().then_some(co_simulation))
        .holding_all(model.is_for_scheduled_execution().then_some(scheduled))
}
