//! Rules for units and their use in types and variables.

use std::collections::{HashMap, HashSet};

use fmu_description::value::{boolean, real};
use fmu_description::xml::Element;
use fmu_file::text::quote;

use super::{Kind, Model, unique};
use crate::finding::Findings;
use crate::rule::rules;

rules! {
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
}

/// The display units of each unit, by unit name.
type Units<'a> = HashMap<&'a str, HashSet<&'a str>>;

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    let defined = || model.root.list("UnitDefinitions", "Unit");
    unique(defined(), "unit", findings);
    let mut units = Units::new();
    for unit in defined() {
        factors(unit, findings);
        let displays = unique(unit.children("DisplayUnit"), "display unit", findings);
        if let Some(name) = unit.attribute("name") {
            units.insert(name, displays);
        }
    }
    for (_, value) in model.types() {
        if matches!(value.name, "Real" | "Float32Type" | "Float64Type") {
            usage(value, value.attribute("unit"), &units, findings);
        }
    }
    for (_, variable) in model.variables() {
        if variable.kind == Kind::Float {
            usage(variable.value, variable.unit(), &units, findings);
            for alias in variable.value.children("Alias") {
                usage(alias, variable.unit(), &units, findings);
            }
        }
    }
}

/// Checks that a unit can be converted to its base unit and its display units.
fn factors(unit: &Element<'_>, findings: &mut Findings) {
    for child in &unit.children {
        let number = |name: &str| child.attribute(name).and_then(real);
        if child.attribute("inverse").and_then(boolean) == Some(true)
            && let Some(offset) = number("offset")
            && offset != 0.0
        {
            let text = format!("the offset of an inverse unit is {offset}, expected 0");
            findings.add(&INVERSE_OFFSET, child, text);
        }
        if let Some(factor) = number("factor")
            && (factor == 0.0 || !factor.is_finite())
        {
            findings.add(
                &UNIT_FACTOR,
                child,
                format!("the factor of a unit is {factor}, expected a number other than 0"),
            );
        }
        if let Some(offset) = number("offset")
            && !offset.is_finite()
        {
            findings.add(
                &UNIT_OFFSET,
                child,
                format!("the offset of a unit is {offset}, expected a finite number"),
            );
        }
    }
}

/// Checks that the unit and the display unit of a type or variable are defined.
fn usage(value: &Element<'_>, unit: Option<&str>, units: &Units<'_>, findings: &mut Findings) {
    let displays = unit.and_then(|unit| units.get(unit));
    if let Some(own) = value.attribute("unit")
        && displays.is_none()
    {
        findings.add(
            &UNIT_DEFINED,
            value,
            format!(
                "the unit {} is not defined, expected one of UnitDefinitions",
                quote(own)
            ),
        );
    }
    let Some(display) = value.attribute("displayUnit") else {
        return;
    };
    if unit.is_none() {
        findings.add(
            &DISPLAY_UNIT_NEEDS_UNIT,
            value,
            format!(
                "displayUnit is {} without a unit, expected both",
                quote(display)
            ),
        );
    } else if displays.is_some_and(|displays| !displays.contains(display)) && unit != Some(display)
    {
        findings.add(
            &DISPLAY_UNIT_DEFINED,
            value,
            format!(
                "the display unit {} is not defined for its unit, expected a DisplayUnit",
                quote(display)
            ),
        );
    }
}
