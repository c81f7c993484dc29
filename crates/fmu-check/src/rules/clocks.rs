//! Rules for clocks and clocked variables (FMI 3.0.2, sections 2.4.4 and 2.4.7.4).

use std::collections::{HashMap, HashSet};

use fmu_description::value::{boolean, items, real, unsigned};
use fmu_description::xml::Element;
use fmu_description::{Causality, Variability};

use super::{Kind, Model};
use crate::finding::{Findings, Location};
use crate::rule::rules;

rules! {
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

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    let root = model.root;
    let is_scheduled = root.child("ScheduledExecution").is_some();
    let mut previous = HashSet::new();
    let has_clocks = model.elements().any(|variable| variable.name == "Clock");
    for slave in root.children("CoSimulation").filter(|_| has_clocks) {
        if slave.attribute("hasEventMode").and_then(boolean) != Some(true) {
            let text = "the FMU has clocks, expected hasEventMode = true";
            findings.add(&CLOCKS_NEED_EVENTS, slave, text);
        }
    }
    let mut types = HashMap::new();
    for defined in root.list("TypeDefinitions", "ClockType") {
        interval(defined, None, findings);
        types.insert(defined.attribute("name").unwrap_or_default(), defined);
    }
    for (_, typed) in model.variables() {
        let variable = typed.element;
        let at = || Location::of_variable(variable);
        let is_clock = variable.name == "Clock";
        let causality = variable.attribute("causality").unwrap_or("local");
        if is_clock {
            if !["input", "output", "local"].contains(&causality) {
                let text =
                    format!("the clock has causality {causality}, expected input, output or local");
                findings.add(&CLOCK_CAUSALITY, at(), text);
            }
            let declared = variable.attribute("declaredType");
            let declared = declared.and_then(|name| types.get(name).copied());
            interval(variable, declared, findings);
            let priority = |element: &Element<'_>| element.attribute("priority").is_some();
            if causality == "output" && priority(variable) {
                let text = "the output has a priority, expected none";
                findings.add(&CLOCK_PRIORITY, at(), text);
            }
            if is_scheduled
                && causality == "input"
                && !priority(variable)
                && !declared.is_some_and(priority)
            {
                findings.add(
                    &CLOCK_PRIORITY,
                    at(),
                    "it has no priority, expected one in Scheduled Execution",
                );
            }
        }
        let clocks = variable.attribute("clocks");
        let variability = typed.variability.as_str();
        let is_tunable = variability == "tunable" && !is_clock;
        if (is_clock || clocks.is_some()) && variability != "discrete" && !is_tunable {
            let (what, expected) = match is_clock {
                true => ("a clock", "discrete"),
                false => ("clocked", "discrete or tunable"),
            };
            let text = format!("it is {what} with variability {variability}, expected {expected}");
            findings.add(&CLOCKED_VARIABILITY, at(), text);
        }
        if clocks.is_some_and(|clocks| items(clocks).next().is_none()) {
            findings.add(
                &CLOCKS_EXIST,
                at(),
                "clocks is empty, expected value references of clocks",
            );
        }
        for clock in items(clocks.unwrap_or_default()) {
            let of = unsigned(clock).and_then(|number| model.variable(model.index(number)));
            if of.is_none_or(|of| of.kind != Kind::Clock) {
                let text = format!("clocks has {clock}, expected value references of clocks");
                findings.add(&CLOCKS_EXIST, at(), text);
            }
        }
        if typed.variability != Variability::Continuous
            && variable.attribute("intermediateUpdate").and_then(boolean) == Some(true)
        {
            let text =
                "it has intermediateUpdate = true, expected it only for continuous variables";
            findings.add(&INTERMEDIATE_UPDATE, at(), text);
        }
        let Some(reference) = variable.attribute("previous") else {
            continue;
        };
        if clocks.is_none() || variability != "discrete" {
            let text = "it has previous, expected it only for discrete variables with clocks";
            findings.add(&PREVIOUS_CLOCKED, at(), text);
        }
        let before = model.referred(variable, "previous").filter(|before| {
            before.value.name == variable.name
                && before.variability == Variability::Discrete
                && before.causality != Causality::Input
                && before.reference != typed.reference
        });
        if before.is_none() || !previous.insert(reference.trim()) {
            let kind = variable.name;
            let text = format!(
                "previous is {reference}, expected the value reference of another discrete {kind} \
                 that is no input, and of each at most once"
            );
            findings.add(&PREVIOUS_REFERENCE, at(), text);
        }
    }
}

/// Checks when a clock ticks; a variable inherits from its declared type.
fn interval(clock: &Element<'_>, declared: Option<&Element<'_>>, findings: &mut Findings) {
    let at = || Location::of_variable(clock);
    let inherited = |name: &str| {
        let own = clock.attribute(name);
        own.or_else(|| declared?.attribute(name))
    };
    for (name, may_be_zero) in [
        ("intervalDecimal", false),
        ("intervalCounter", false),
        ("shiftDecimal", true),
    ] {
        if let Some(value) = clock.attribute(name).and_then(real)
            && !(value > 0.0 || may_be_zero && value == 0.0)
        {
            let expected = if may_be_zero {
                "0 or more"
            } else {
                "a positive number"
            };
            findings.add(
                &CLOCK_INTERVAL,
                at(),
                format!("{name} is {value}, expected {expected}"),
            );
        }
    }
    let variability = clock.attribute("intervalVariability").unwrap_or_default();
    if variability == "constant" && inherited("intervalDecimal").is_none() {
        let text = "the clock is constant and has no intervalDecimal, expected one";
        findings.add(&CLOCK_INTERVAL_GIVEN, at(), text);
    }
    for name in ["intervalDecimal", "intervalCounter", "resolution"] {
        if matches!(variability, "changing" | "countdown" | "triggered")
            && clock.attribute(name).is_some()
        {
            let text = format!(
                "it has {name} and intervalVariability {variability}, expected {name} only for \
                 periodic clocks"
            );
            findings.add(&CLOCK_PERIODIC, at(), text);
        }
    }
    for (shift, interval) in [
        ("shiftDecimal", "intervalDecimal"),
        ("shiftCounter", "intervalCounter"),
    ] {
        if clock.attribute(shift).is_some() && inherited(interval).is_none() {
            let text = format!("it has {shift} and no {interval}, expected both");
            findings.add(&CLOCK_SHIFT, at(), text);
        }
    }
    let supports = inherited("supportsFraction").and_then(boolean) == Some(true);
    if clock.attribute("intervalCounter").is_some()
        && !(supports && inherited("resolution").is_some())
    {
        let text =
            "it has intervalCounter, expected a resolution and supportsFraction = true with it";
        findings.add(&CLOCK_FRACTION, at(), text);
    }
}
