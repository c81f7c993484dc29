//! Rules for types, their enumerations, bounds and start values.

use std::collections::{HashMap, HashSet};

use fmu_description::value::{items, real};
use fmu_description::xml::Element;
use fmu_file::text::quote;

use super::{Kind, Model, Variable, unique};
use crate::finding::{Findings, Location};
use crate::rule::rules;

rules! {
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

/// The item values of each enumeration type, by type name.
type Items<'a> = HashMap<&'a str, HashSet<i64>>;

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    unique(model.types().map(|(defined, _)| defined), "type", findings);
    let mut items = Items::new();
    for (defined, value) in model.types() {
        if let Some(name) = defined.attribute("name") {
            bounds(value, value, None, findings);
            items.insert(name, enumeration(value, findings));
        }
    }
    for (_, variable) in model.variables() {
        declared_type(variable, findings);
        if items.contains_key(variable.name) {
            let text = "a type has the same name, expected another name";
            findings.add(&TYPE_NAME, variable, text);
        }
        if matches!(
            variable.kind,
            Kind::Float | Kind::Integer | Kind::Enumeration
        ) {
            bounds(variable.value, variable, variable.declared, findings);
        }
        if variable.kind == Kind::Enumeration {
            start_item(variable, &items, findings);
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
    let number = |name: &str| {
        let own = value.attribute(name);
        own.or_else(|| declared?.attribute(name)).and_then(real)
    };
    let (min, max) = (number("min"), number("max"));
    if let Some(nominal) = value.attribute("nominal").and_then(real)
        && (nominal <= 0.0 || !nominal.is_finite())
    {
        let text = format!("nominal is {nominal}, expected a positive number");
        findings.add(&NOMINAL, at, text);
    }
    let of_type = |name: &str| declared?.attribute(name).and_then(real);
    for (name, own, of_type) in [("min", min, of_type("min")), ("max", max, of_type("max"))] {
        if let (Some(own), Some(of_type)) = (own, of_type)
            && if name == "min" {
                own < of_type
            } else {
                own > of_type
            }
        {
            let text = format!("{name} is {own}, expected it within {name} {of_type} of its type");
            findings.add(&BOUNDS_OF_TYPE, at, text);
        }
    }
    if let (Some(min), Some(max)) = (min, max)
        && (min > max || min.is_nan() || max.is_nan())
    {
        findings.add(
            &MIN_MAX,
            at,
            format!("min is {min} and max is {max}, expected min <= max"),
        );
    }
    let starts = || items(value.attribute("start").unwrap_or_default()).filter_map(real);
    if let Some(start) = starts().find(|start| !start.is_finite()) {
        findings.add(
            &FINITE_START,
            at,
            format!("start is {start}, expected a finite number"),
        );
    }
    let is_outside =
        |start: f64| min.is_some_and(|min| start < min) || max.is_some_and(|max| start > max);
    if let Some(start) = starts().find(|start| is_outside(*start)) {
        let bound = |bound: Option<f64>| bound.map_or("none".into(), |bound| bound.to_string());
        findings.add(
            &START_IN_BOUNDS,
            at,
            format!(
                "start is {start}, expected it from min {} to max {}",
                bound(min),
                bound(max)
            ),
        );
    }
}

/// Checks the items of an enumeration and returns their values.
fn enumeration(value: &Element<'_>, findings: &mut Findings) -> HashSet<i64> {
    let items = || value.children("Item");
    unique(items(), "item", findings);
    let mut values = HashSet::new();
    for item in items() {
        if let Some(number) = item.attribute("value").and_then(whole)
            && !values.insert(number)
        {
            findings.add(
                &ITEM_VALUES_UNIQUE,
                item,
                format!("two items have the value {number}, expected each value once"),
            );
        }
    }
    values
}

fn declared_type(variable: &Variable<'_>, findings: &mut Findings) {
    let Some(declared) = variable.value.attribute("declaredType") else {
        return;
    };
    let is = match variable.declared {
        Some(of_type)
            if of_type.name.strip_suffix("Type").unwrap_or(of_type.name) == variable.value.name =>
        {
            return;
        }
        Some(of_type) => format!(
            "is {}, expected {}",
            quote(of_type.name),
            variable.value.name
        ),
        None => "is not defined, expected one of TypeDefinitions".into(),
    };
    findings.add(
        &DECLARED_TYPE,
        variable,
        format!("the type {} {is}", quote(declared)),
    );
}

/// Parses a whole number.
fn whole(text: &str) -> Option<i64> {
    text.trim().parse().ok()
}

/// Checks that the start value of an enumeration is one of its items.
fn start_item(variable: &Variable<'_>, items: &Items<'_>, findings: &mut Findings) {
    let declared = variable.value.attribute("declaredType");
    let Some(items) = declared.and_then(|name| items.get(name)) else {
        return;
    };
    let mut starts = variable.starts().filter_map(whole);
    if let Some(start) = starts.find(|start| !items.contains(start)) {
        findings.add(
            &START_IS_ITEM,
            variable,
            format!("start is {start}, expected the value of an item of its type"),
        );
    }
}
