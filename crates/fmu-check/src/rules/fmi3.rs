//! Rules for what FMI 3.0 adds: arrays and structural parameters (FMI 3.0.2, section 2.4.7.2), clocks and
//! clocked variables (sections 2.4.4 and 2.4.7.4).

use std::collections::{HashMap, HashSet};

use fmu_description::value::{items, unsigned, whole};
use fmu_description::xml::Element;
use fmu_description::{Causality, Listed, ModelDescription, Type, Variability};

use super::definitions::is_clocked;
use crate::finding::{Findings, Location, find, require};
use crate::rule::rules;

rules! {
    /// Arrays and structural parameters.
    pub ARRAYS {
        DIMENSION_SIZE: Error, "dimension-size", Fmi3("section 2.4.7.2"),
            "A Dimension has either start or valueReference.";
        DIMENSION_REFERENCE: Error, "dimension-reference", Fmi3("section 2.4.7.2"),
            "valueReference of a Dimension is that of a UInt64, which is a constant or a structural parameter.";
        DIMENSION_POSITIVE: Error, "dimension-positive", Fmi3("section 2.4.7.2"),
            "The initial size of a dimension is not 0.";
        STRUCTURAL_SCALAR: Error, "structural-scalar", Fmi3("section 2.4.7.4"),
            "A structural parameter has no dimensions.";
        START_COUNT: Error, "start-count", Fmi3("section 2.4.7.5"),
            "A variable with start values has one, or one for each of its elements.";
        START_SIZE: Error, "start-size", Fmi3("section 2.4.4"),
            "The start value of a Binary is not longer than maxSize.";
    }

    /// Clocks and clocked variables.
    pub CLOCKS {
        CLOCK_CAUSALITY: Error, "clock-causality", Fmi3("section 2.4.7.4"),
            "A clock is an input, an output or local.";
        CLOCKED_VARIABILITY: Error, "clocked-variability", Fmi3("section 2.4.7.4"),
            "Clocks are discrete, and clocked variables discrete or tunable.";
        CLOCKS_EXIST: Error, "clocks-exist", Fmi3("section 2.4.7.4"),
            "clocks has value references of clocks, at least one.";
        PREVIOUS_CLOCKED: Error, "previous-clocked", Fmi3("section 2.4.7.4"),
            "Only discrete clocked variables have previous.";
        PREVIOUS_REFERENCE: Error, "previous-reference", Fmi3("section 2.4.7.4"),
            "previous is the value reference of another discrete variable of the same type, which is no input, and of each at most once.";
        CLOCK_INTERVAL: Error, "clock-interval", Fmi3("section 2.4.4"),
            "The interval of a clock is positive, and its shift is not negative.";
        CLOCK_INTERVAL_GIVEN: Error, "clock-interval-given", Fmi3("section 2.4.4"),
            "A constant clock has intervalDecimal.";
        CLOCK_PERIODIC: Error, "clock-periodic", Fmi3("section 2.4.4"),
            "Only periodic clocks (constant, fixed, tunable) have intervalDecimal, intervalCounter and resolution.";
        CLOCK_SHIFT: Error, "clock-shift", Fmi3("section 2.4.4"),
            "shiftDecimal is given with intervalDecimal, and shiftCounter with intervalCounter.";
        CLOCK_FRACTION: Error, "clock-fraction", Fmi3("section 2.4.4"),
            "intervalCounter is given with a resolution and supportsFraction.";
        CLOCK_PRIORITY: Error, "clock-priority", Fmi3("section 2.4.4"),
            "In Scheduled Execution, input clocks have a priority; output clocks never have one.";
        CLOCKS_NEED_EVENTS: Error, "clocks-need-events", Fmi3("section 4.4"),
            "An FMU for Co-Simulation with clocks has hasEventMode.";
        INTERMEDIATE_UPDATE: Error, "intermediate-update", Fmi3("section 2.4.7.4"),
            "Only continuous variables have intermediateUpdate = true.";
    }
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    for (_, variable) in model.variables() {
        start_size(variable, findings);
        elements(variable, model, findings);
    }
    clocks(model, findings);
}

/// Checks the number of bytes of the start values of a Binary.
fn start_size(variable: &Listed<'_>, findings: &mut Findings) {
    let max = variable.inherited("maxSize").and_then(unsigned);
    let max = max.unwrap_or(u32::MAX);
    for start in variable.element.children("Start") {
        // Two digits a byte.
        let size = start.attribute("value").unwrap_or_default().trim().len() / 2;
        require!(findings, START_SIZE at variable, size <= max as usize,
            "its start value has {size} bytes, expected at most maxSize = {max}");
    }
}

/// Checks the dimensions of a variable, and how many start values it has.
fn elements(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let element = variable.element;
    if variable.causality == Causality::StructuralParameter
        && let Some(dimension) = element.child("Dimension")
    {
        find!(findings, STRUCTURAL_SCALAR at dimension,
            "the structural parameter has a Dimension, expected none");
    }
    let mut size = Some(1_u64);
    for dimension in element.children("Dimension") {
        let length = length(dimension, model, findings);
        size = size.zip(length).and_then(|(a, b)| a.checked_mul(b));
    }
    let is_list = matches!(variable.of_type, Type::String | Type::Binary);
    let starts = match is_list {
        true => element.children("Start").count(),
        false => element
            .attribute("start")
            .map_or(1, |start| items(start).count()),
    };
    if let Some(size) = size {
        let fits = starts == 1 || starts as u64 == size || is_list && starts == 0;
        let or_more = if size == 1 {
            String::new()
        } else {
            format!(" or {size}")
        };
        require!(findings, START_COUNT at variable, fits,
            "it has {starts} start values, expected 1{or_more}");
    }
}

/// The initial size of a dimension, if it is valid.
fn length(
    dimension: &Element<'_>,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) -> Option<u64> {
    let attribute = |name| dimension.attribute(name);
    let start = match (attribute("start"), attribute("valueReference")) {
        (Some(start), None) => start,
        (None, Some(reference)) => {
            let is_size = |v: &&Listed<'_>| {
                let is_structural = v.causality == Causality::StructuralParameter;
                v.of_type == Type::UInt64
                    && (is_structural || v.variability == Variability::Constant)
            };
            let Some(size) = model.referred(dimension, "valueReference").filter(is_size) else {
                find!(findings, DIMENSION_REFERENCE at dimension,
                    "valueReference of the Dimension is {reference}, expected that of a UInt64 that \
                     is a constant or a structural parameter");
                return None;
            };
            size.start()?
        }
        (start, _) => {
            let both = if start.is_some() {
                "both start and"
            } else {
                "neither start nor"
            };
            find!(findings, DIMENSION_SIZE at dimension,
                "the Dimension has {both} valueReference, expected one of them");
            return None;
        }
    };
    let length = whole(start)?;
    require!(findings, DIMENSION_POSITIVE at dimension, length > 0,
        "the initial size of the Dimension is 0, expected a positive number");
    Some(length)
}

fn clocks(model: &ModelDescription<'_>, findings: &mut Findings) {
    let has_clocks = model.variables().any(|(_, v)| v.of_type == Type::Clock);
    for interface in model.root.children("CoSimulation") {
        require!(findings, CLOCKS_NEED_EVENTS at interface, !has_clocks || interface.is_true("hasEventMode"),
            "the FMU has clocks, expected hasEventMode = true");
    }
    let mut types = HashMap::new();
    for defined in model.root.list("TypeDefinitions", "ClockType") {
        interval(defined, None, findings);
        types.insert(defined.attribute("name").unwrap_or_default(), defined);
    }
    let mut previous = HashSet::new();
    for (_, variable) in model.variables() {
        if variable.of_type == Type::Clock {
            clock(variable, model, &types, findings);
        }
        clocked(variable, model, findings);
        if let Some(reference) = variable.element.attribute("previous") {
            let is_first = previous.insert(reference.trim());
            previous_value(variable, reference, is_first, model, findings);
        }
    }
}

fn clock(
    variable: &Listed<'_>,
    model: &ModelDescription<'_>,
    types: &HashMap<&str, &Element<'_>>,
    findings: &mut Findings,
) {
    use Causality::{Input, Local, Output};
    let (clock, causality) = (variable.element, variable.causality);
    require!(findings, CLOCK_CAUSALITY at variable, matches!(causality, Input | Output | Local),
        "the clock has causality {}, expected input, output or local", causality.as_str());
    let declared = clock.attribute("declaredType");
    let declared = declared.and_then(|name| types.get(name).copied());
    interval(clock, declared, findings);
    let has_priority = clock.has("priority");
    require!(findings, CLOCK_PRIORITY at variable, causality != Output || !has_priority,
        "the output has a priority, expected none");
    let inherits = declared.is_some_and(|declared| declared.has("priority"));
    let needs_one = causality == Input && model.scheduled_execution().is_some();
    require!(findings, CLOCK_PRIORITY at variable, !needs_one || has_priority || inherits,
        "it has no priority, expected one in Scheduled Execution");
}

/// Checks the clocks of a variable, and the variability of clocks and clocked variables.
fn clocked(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let clocks = variable.element.attribute("clocks");
    let (what, expected) = match variable.of_type {
        Type::Clock => ("a clock", "discrete"),
        _ => ("clocked", "discrete or tunable"),
    };
    let is_clock = variable.of_type == Type::Clock;
    let fits = match variable.variability {
        Variability::Discrete => true,
        Variability::Tunable => !is_clock,
        _ => !is_clock && clocks.is_none(),
    };
    require!(findings, CLOCKED_VARIABILITY at variable, fits,
        "it is {what} with variability {}, expected {expected}", variable.variability.as_str());
    require!(findings, CLOCKS_EXIST at variable, clocks.is_none_or(|all| items(all).next().is_some()),
        "clocks is empty, expected value references of clocks");
    for clock in items(clocks.unwrap_or_default()) {
        let of = unsigned(clock).and_then(|number| model.variable(model.index(number)));
        require!(findings, CLOCKS_EXIST at variable, of.is_some_and(|of| of.of_type == Type::Clock),
            "clocks has {clock}, expected value references of clocks");
    }
    let is_continuous = variable.variability == Variability::Continuous;
    let is_updated = variable.element.is_true("intermediateUpdate");
    require!(findings, INTERMEDIATE_UPDATE at variable, !is_updated || is_continuous,
        "it has intermediateUpdate = true, expected it only for continuous variables");
}

fn previous_value(
    variable: &Listed<'_>,
    reference: &str,
    is_first: bool,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    let is_discrete = |v: &Listed<'_>| v.variability == Variability::Discrete;
    require!(findings, PREVIOUS_CLOCKED at variable, is_clocked(variable) && is_discrete(variable),
        "it has previous, expected it only for discrete variables with clocks");
    let kind = variable.value.name;
    let fits = |before: &Listed<'_>| {
        let is_other = before.reference != variable.reference;
        is_other
            && before.value.name == kind
            && is_discrete(before)
            && before.causality != Causality::Input
    };
    let before = model.referred(variable.element, "previous");
    require!(findings, PREVIOUS_REFERENCE at variable, before.is_some_and(fits) && is_first,
        "previous is {reference}, expected the value reference of another discrete {kind} that is no \
         input, and of each at most once");
}

/// Checks when a clock ticks; a variable inherits from its declared type.
fn interval(clock: &Element<'_>, declared: Option<&Element<'_>>, findings: &mut Findings) {
    let at = || Location::of_variable(clock);
    let has = |name| clock.has(name) || declared.is_some_and(|declared| declared.has(name));
    for (name, may_be_zero, expected) in [
        ("intervalDecimal", false, "a positive number"),
        ("intervalCounter", false, "a positive number"),
        ("shiftDecimal", true, "0 or more"),
    ] {
        let value = clock.real(name).unwrap_or(1.0);
        require!(findings, CLOCK_INTERVAL at at(), value > 0.0 || may_be_zero && value == 0.0,
            "{name} is {value}, expected {expected}");
    }
    let variability = clock.attribute("intervalVariability").unwrap_or_default();
    require!(findings, CLOCK_INTERVAL_GIVEN at at(), variability != "constant" || has("intervalDecimal"),
        "the clock is constant and has no intervalDecimal, expected one");
    let is_periodic = !matches!(variability, "changing" | "countdown" | "triggered");
    for name in ["intervalDecimal", "intervalCounter", "resolution"] {
        require!(findings, CLOCK_PERIODIC at at(), is_periodic || !clock.has(name),
            "it has {name} and intervalVariability {variability}, expected {name} only for periodic \
             clocks");
    }
    for (shift, interval) in [
        ("shiftDecimal", "intervalDecimal"),
        ("shiftCounter", "intervalCounter"),
    ] {
        require!(findings, CLOCK_SHIFT at at(), !clock.has(shift) || has(interval),
            "it has {shift} and no {interval}, expected both");
    }
    let own = clock.attribute("supportsFraction").is_some();
    let supports = match declared {
        Some(declared) if !own => declared.is_true("supportsFraction"),
        _ => clock.is_true("supportsFraction"),
    };
    require!(findings, CLOCK_FRACTION at at(),
        !clock.has("intervalCounter") || supports && has("resolution"),
        "it has intervalCounter, expected a resolution and supportsFraction = true with it");
}
