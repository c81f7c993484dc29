//! Rules for the root attributes, log categories, interface types and default experiment, for units and
//! types, and for what uses them: bounds, start values and display units.

use std::collections::{HashMap, HashSet};

use fmu_description::value::{items, real, whole};
use fmu_description::words::is_identifier;
use fmu_description::xml::Element;
use fmu_description::{FmiVersion, Listed, ModelDescription, Type};
use fmu_file::text::quote;

use crate::finding::{Findings, Location, find, require};
use crate::package::{INTERFACES, interfaces};
use crate::rule::rules;

rules! {
    /// The FMU as a whole.
    pub ROOT {
        FMI_VERSION: Error, "fmi-version", Standard("section 2.2.1", "section 2.4.1"),
            "The FMU is of FMI version 2.0 or 3.0; nothing else is checked of another version.";
        NAME_AND_GUID: Error, "name-and-guid", Standard("section 2.2.1", "section 2.4.1"),
            "modelName and guid, in FMI 3.0 instantiationToken, are not empty.";
        UTC: Warning, "generation-utc", Standard("section 2.2.1", "section 2.4.1"),
            "generationDateAndTime is in UTC.";
        KIND_ONCE: Error, "interface-once", Fmi2("section 2.2.1"),
            "ModelExchange and CoSimulation appear at most once each.";
        INTERFACE_GIVEN: Error, "interface-given", Fmi3("section 2.4.1"),
            "There is an interface type: ModelExchange, CoSimulation or ScheduledExecution.";
        EVENT_INDICATORS: Warning, "event-indicators",
            Practice("importers have to assume that there are none"),
            "An FMU for model exchange declares numberOfEventIndicators.";
        MODEL_IDENTIFIER: Error, "model-identifier", Standard("sections 3.3.1 and 4.3.1", "section 2.4.2"),
            "modelIdentifier is an identifier of C.";
        SERIALIZE_NEEDS_GET: Error, "serialize-needs-get", Standard("sections 3.3.1 and 4.3.1", "section 2.4.2"),
            "An FMU that can serialize its state can get and set it.";
        EARLY_RETURN: Error, "early-return", Fmi3("section 4.4"),
            "An FMU that can return early after an intermediate update provides these updates.";
        INTERNAL_STEP: Error, "internal-step", Fmi3("section 4.4"),
            "fixedInternalStepSize is a positive number.";
        EXPERIMENT_NUMBERS: Error, "experiment-numbers", Standard("section 2.2.5", "section 2.4.6"),
            "The times of the default experiment are finite, its tolerance and step size positive.";
        STOP_AFTER_START: Error, "stop-after-start", Standard("section 2.2.5", "section 2.4.6"),
            "The default experiment stops after it starts.";
        STEP_IN_EXPERIMENT: Warning, "step-in-experiment", Practice("VDMCheck2 requires it"),
            "The step size of the default experiment is not larger than its duration.";
    }
}

fn root(model: &ModelDescription<'_>, findings: &mut Findings) {
    let root = model.root;
    let token = match model.version {
        FmiVersion::Fmi2 => "guid",
        FmiVersion::Fmi3 => "instantiationToken",
    };
    for name in ["modelName", token] {
        let is_given = root
            .attribute(name)
            .is_none_or(|text| !text.trim().is_empty());
        require!(findings, NAME_AND_GUID at root, is_given, "{name} is empty, expected a string");
    }
    if let Some(date) = root.attribute("generationDateAndTime") {
        require!(findings, UTC at root, date.trim().ends_with('Z'),
            "generationDateAndTime is {}, expected a time in UTC, which ends in Z", quote(date));
    }
    unique(
        root.list("LogCategories", "Category"),
        "log category",
        findings,
    );
    unique(root.list("VendorAnnotations", "Tool"), "tool", findings);
    match model.version {
        FmiVersion::Fmi2 => interfaces_2(root, findings),
        FmiVersion::Fmi3 => {
            require!(findings, INTERFACE_GIVEN at root, interfaces(root).next().is_some(),
                "it has no interface type, expected ModelExchange, CoSimulation or \
                 ScheduledExecution");
        }
    }
    for interface in interfaces(root) {
        claims(interface, model.version, findings);
    }
    if let Some(element) = root.child("DefaultExperiment") {
        experiment(element, findings);
    }
}

/// What the schema of FMI 3.0 requires, but not the schema of FMI 2.0.
fn interfaces_2(root: &Element<'_>, findings: &mut Findings) {
    for kind in INTERFACES {
        if let Some(second) = root.children(kind).nth(1) {
            find!(findings, KIND_ONCE at second, "{kind} appears twice, expected it once");
        }
    }
    let is_exchange = root.child("ModelExchange").is_some();
    require!(findings, EVENT_INDICATORS at root, !is_exchange || root.has("numberOfEventIndicators"),
        "numberOfEventIndicators is missing, expected it for model exchange");
}

/// Checks the attributes of an interface type.
fn claims(interface: &Element<'_>, version: FmiVersion, findings: &mut Findings) {
    if let Some(identifier) = interface.attribute("modelIdentifier") {
        require!(findings, MODEL_IDENTIFIER at interface, is_identifier(identifier),
            "modelIdentifier is {}, expected a C identifier", quote(identifier));
    }
    let state = match version {
        FmiVersion::Fmi2 => ["canSerializeFMUstate", "canGetAndSetFMUstate"],
        FmiVersion::Fmi3 => ["canSerializeFMUState", "canGetAndSetFMUState"],
    };
    let early = [
        "canReturnEarlyAfterIntermediateUpdate",
        "providesIntermediateUpdate",
    ];
    for (rule, [flag, needed]) in [(&SERIALIZE_NEEDS_GET, state), (&EARLY_RETURN, early)] {
        if interface.is_true(flag) && !interface.is_true(needed) {
            let text = format!("{flag} is true, expected {needed} to be true with it");
            findings.add(rule, interface, text);
        }
    }
    let step = interface.real("fixedInternalStepSize").unwrap_or(1.0);
    require!(findings, INTERNAL_STEP at interface, step > 0.0 && step.is_finite(),
        "fixedInternalStepSize is {step}, expected a positive number");
}

fn experiment(element: &Element<'_>, findings: &mut Findings) {
    for (name, above, expected) in [
        ("startTime", f64::NEG_INFINITY, "a finite number"),
        ("stopTime", f64::NEG_INFINITY, "a finite number"),
        ("tolerance", 0.0, "a positive number"),
        ("stepSize", 0.0, "a positive number"),
    ] {
        let value = element.real(name).unwrap_or(1.0);
        require!(findings, EXPERIMENT_NUMBERS at element, value.is_finite() && value > above,
            "{name} is {value}, expected {expected}");
    }
    let start = element.real("startTime").unwrap_or(0.0);
    if let Some(stop) = element.real("stopTime") {
        let (span, step) = (stop - start, element.real("stepSize").unwrap_or(0.0));
        require!(findings, STOP_AFTER_START at element, stop > start,
            "stopTime is {stop}, expected it after startTime {start}");
        require!(findings, STEP_IN_EXPERIMENT at element, span <= 0.0 || step <= span * (1.0 + 1e-9),
            "stepSize is {step}, expected at most stopTime - startTime = {span}");
    }
}

rules! {
    /// Names of units, types, items and log categories.
    pub DEFINITIONS {
        NAMES_GIVEN: Error, "definition-named", Standard("section 2.2", "section 2.4"),
            "Units, types, items, log categories and tools have a name.";
        NAMES_UNIQUE: Error, "definition-unique", Standard("section 2.2", "section 2.4"),
            "Names of units, types, items, log categories and tools are unique.";
    }

    /// Units.
    pub UNITS {
        UNIT_FACTOR: Error, "unit-factor", Standard("section 2.2.2", "section 2.4.3"),
            "The factor of a unit is a number other than 0.";
        UNIT_OFFSET: Error, "unit-offset", Standard("section 2.2.2", "section 2.4.3"),
            "The offset of a unit is finite.";
        INVERSE_OFFSET: Error, "inverse-offset", Fmi3("section 2.4.3"),
            "An inverse display unit has no offset.";
        UNIT_DEFINED: Error, "unit-defined", Standard("sections 2.2.3 and 2.2.7", "sections 2.4.4 and 2.4.7.5"),
            "A unit that is used is defined in UnitDefinitions.";
        DISPLAY_UNIT_NEEDS_UNIT: Error, "display-unit-needs-unit", Standard("sections 2.2.3 and 2.2.7", "sections 2.4.4 and 2.4.7.5"),
            "What has a display unit has a unit.";
        DISPLAY_UNIT_DEFINED: Error, "display-unit-defined", Standard("sections 2.2.3 and 2.2.7", "sections 2.4.4 and 2.4.7.5"),
            "A display unit is defined for its unit.";
    }

    /// Types, bounds and start values.
    pub TYPES {
        MIN_MAX: Error, "min-max", Standard("sections 2.2.3 and 2.2.7", "section 2.4.4"),
            "min is not larger than max.";
        TYPE_NAME: Error, "type-name", Standard("section 2.2.3", "section 2.4.4"),
            "A type and a variable have different names.";
        NOMINAL: Error, "nominal", Standard("sections 2.2.3 and 2.2.7", "section 2.3.3"),
            "nominal is a positive number.";
        BOUNDS_OF_TYPE: Warning, "bounds-of-type", Practice("VDMCheck2 requires it"),
            "min and max of a variable are within those of its type.";
        FINITE_START: Warning, "start-finite",
            Practice("a simulation that starts from NaN or infinity gives no numbers"),
            "Start values are finite.";
        START_IN_BOUNDS: Error, "start-in-bounds", Standard("section 2.2.7", "section 2.4.4"),
            "A start value is within min and max.";
        ITEM_VALUES_UNIQUE: Error, "item-values-unique", Standard("section 2.2.3", "section 2.4.4"),
            "The items of an enumeration have different values.";
        DECLARED_TYPE: Error, "declared-type", Standard("section 2.2.7", "section 2.4.7.5"),
            "declaredType names a type of TypeDefinitions, of the same kind as the variable.";
        START_IS_ITEM: Error, "start-is-item", Standard("section 2.2.7", "section 2.4.7.5"),
            "The start value of an enumeration is the value of one of its items.";
    }
}

/// Collects the names of elements, which must be unique.
pub fn unique<'a>(
    elements: impl Iterator<Item = &'a Element<'a>>,
    what: &str,
    findings: &mut Findings,
) -> HashSet<&'a str> {
    let mut names = HashSet::new();
    for element in elements {
        if let Some(name) = element.attribute("name") {
            require!(findings, NAMES_GIVEN at element, !name.is_empty(),
                "the name of a {what} is empty, expected a string");
            require!(findings, NAMES_UNIQUE at element, names.insert(name),
                "the {what} {} is defined twice, expected each name once", quote(name));
        }
    }
    names
}

/// The names of the types of real numbers, for messages.
pub fn float(model: &ModelDescription<'_>) -> &'static str {
    match model.version {
        FmiVersion::Fmi2 => "Real",
        FmiVersion::Fmi3 => "Float32 or Float64",
    }
}

/// What refers to a variable, for messages.
pub fn expected(model: &ModelDescription<'_>) -> String {
    match model.version {
        FmiVersion::Fmi2 => format!("the index of a variable, 1 to {}", model.variables.len()),
        FmiVersion::Fmi3 => "the value reference of a variable".into(),
    }
}

/// Whether a variable is tied to clocks.
pub fn is_clocked(variable: &Listed<'_>) -> bool {
    variable.element.has("clocks")
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    root(model, findings);
    units(model, findings);
    types(model, findings);
}

/// The display units of each unit, by unit name.
type Units<'a> = HashMap<&'a str, HashSet<&'a str>>;

fn units(model: &ModelDescription<'_>, findings: &mut Findings) {
    let defined = || model.root.list("UnitDefinitions", "Unit");
    unique(defined(), "unit", findings);
    let mut units = Units::new();
    for unit in defined() {
        unit.children
            .iter()
            .for_each(|child| conversion(child, findings));
        let displays = unique(unit.children("DisplayUnit"), "display unit", findings);
        units.extend(unit.attribute("name").map(|name| (name, displays)));
    }
    for (_, value) in model.types() {
        if matches!(value.name, "Real" | "Float32Type" | "Float64Type") {
            usage(value, value.attribute("unit"), &units, findings);
        }
    }
    for (_, variable) in model.variables().filter(|(_, v)| v.of_type.is_float()) {
        let aliases = variable.value.children("Alias");
        for element in [variable.value].into_iter().chain(aliases) {
            usage(element, variable.inherited("unit"), &units, findings);
        }
    }
}

/// Checks that a base unit or display unit can be converted.
fn conversion(unit: &Element<'_>, findings: &mut Findings) {
    let factor = unit.real("factor").unwrap_or(1.0);
    let offset = unit.real("offset").unwrap_or(0.0);
    require!(findings, INVERSE_OFFSET at unit, !unit.is_true("inverse") || offset == 0.0,
        "the offset of an inverse unit is {offset}, expected 0");
    require!(findings, UNIT_FACTOR at unit, factor != 0.0 && factor.is_finite(),
        "the factor of a unit is {factor}, expected a number other than 0");
    require!(findings, UNIT_OFFSET at unit, offset.is_finite(),
        "the offset of a unit is {offset}, expected a finite number");
}

/// Checks that the unit and the display unit of a type or variable are defined.
fn usage(value: &Element<'_>, unit: Option<&str>, units: &Units<'_>, findings: &mut Findings) {
    let displays = unit.and_then(|unit| units.get(unit));
    if let Some(own) = value.attribute("unit") {
        require!(findings, UNIT_DEFINED at value, displays.is_some(),
            "the unit {} is not defined, expected one of UnitDefinitions", quote(own));
    }
    if let Some(display) = value.attribute("displayUnit") {
        let shown = quote(display);
        require!(findings, DISPLAY_UNIT_NEEDS_UNIT at value, unit.is_some(),
            "displayUnit is {shown} without a unit, expected both");
        let is_defined = displays.is_none_or(|displays| displays.contains(display));
        require!(findings, DISPLAY_UNIT_DEFINED at value, is_defined || unit == Some(display),
            "the display unit {shown} is not defined for its unit, expected a DisplayUnit");
    }
}

/// The item values of each enumeration type, by type name.
type Items<'a> = HashMap<&'a str, HashSet<i64>>;

fn types(model: &ModelDescription<'_>, findings: &mut Findings) {
    unique(model.types().map(|(defined, _)| defined), "type", findings);
    let mut items = Items::new();
    for (defined, value) in model.types() {
        if let Some(name) = defined.attribute("name") {
            bounds(value, value, None, findings);
            items.insert(name, enumeration(value, findings));
        }
    }
    for (_, variable) in model.variables() {
        declared_type(variable, &items, findings);
        require!(findings, TYPE_NAME at variable, !items.contains_key(variable.name.as_str()),
            "a type has the same name, expected another name");
        let (min, max) = variable.of_type.range();
        if variable.of_type.is_float() || min <= max {
            bounds(variable.value, variable, variable.declared, findings);
        }
    }
}

/// Checks that min <= start <= max; a variable inherits the bounds of its type.
fn bounds(
    value: &Element<'_>,
    at: impl Into<Location> + Copy,
    declared: Option<&Element<'_>>,
    findings: &mut Findings,
) {
    let of_type = |name| declared.and_then(|declared| declared.real(name));
    let nominal = value.real("nominal").unwrap_or(1.0);
    require!(findings, NOMINAL at at, nominal > 0.0 && nominal.is_finite(),
        "nominal is {nominal}, expected a positive number");
    let number = |name| value.attribute(name).map_or(of_type(name), real);
    let (min, max) = (number("min"), number("max"));
    for (name, own, sign) in [("min", min, -1.0), ("max", max, 1.0)] {
        if let (Some(own), Some(of_type)) = (own, of_type(name)) {
            require!(findings, BOUNDS_OF_TYPE at at, sign * own <= sign * of_type,
                "{name} is {own}, expected it within {name} {of_type} of its type");
        }
    }
    if let (Some(min), Some(max)) = (min, max) {
        require!(findings, MIN_MAX at at, min <= max,
            "min is {min} and max is {max}, expected min <= max");
    }
    let starts = || items(value.attribute("start").unwrap_or_default()).filter_map(real);
    if let Some(start) = starts().find(|start| !start.is_finite()) {
        find!(findings, FINITE_START at at, "start is {start}, expected a finite number");
    }
    let is_outside = |s: &f64| min.is_some_and(|min| *s < min) || max.is_some_and(|max| *s > max);
    if let Some(start) = starts().find(is_outside) {
        let bound = |bound: Option<f64>| bound.map_or("none".into(), |bound| bound.to_string());
        find!(findings, START_IN_BOUNDS at at,
            "start is {start}, expected it from min {} to max {}", bound(min), bound(max));
    }
}

/// Checks the items of an enumeration and returns their values.
fn enumeration(value: &Element<'_>, findings: &mut Findings) -> HashSet<i64> {
    unique(value.children("Item"), "item", findings);
    let mut values = HashSet::new();
    for item in value.children("Item") {
        if let Some(number) = item.attribute("value").and_then(whole) {
            require!(findings, ITEM_VALUES_UNIQUE at item, values.insert(number),
                "two items have the value {number}, expected each value once");
        }
    }
    values
}

/// Checks that the declared type of a variable is defined, and has its start value if it is an item.
fn declared_type(variable: &Listed<'_>, items: &Items<'_>, findings: &mut Findings) {
    let Some(declared) = variable.value.attribute("declaredType") else {
        return;
    };
    let expected = variable.value.name;
    let fault = match variable.declared.map(|of_type| of_type.name) {
        Some(found) if found.strip_suffix("Type").unwrap_or(found) == expected => None,
        Some(found) => Some(format!("is {}, expected {expected}", quote(found))),
        None => Some("is not defined, expected one of TypeDefinitions".into()),
    };
    if let Some(is) = fault {
        find!(findings, DECLARED_TYPE at variable, "the type {} {is}", quote(declared));
    }
    if let Some(items) = items.get(declared)
        && variable.of_type == Type::Enumeration
    {
        let mut starts = variable.starts().into_iter().filter_map(whole);
        if let Some(start) = starts.find(|start| !items.contains(start)) {
            find!(findings, START_IS_ITEM at variable,
                "start is {start}, expected the value of an item of its type");
        }
    }
}
