//! Rules of types, of their enumerations, and of bounds and starts.

use std::collections::{HashMap, HashSet};

use fmu_file::model::{Kind, Model, Variable, place};
use fmu_file::text::quote;
use fmu_file::value::{integer, real};
use fmu_file::xml::Element;

use super::unique;
use crate::finding::Findings;

/// The values of the items of each enumeration type, by its name.
type Items<'a> = HashMap<&'a str, HashSet<i32>>;

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    let types = || model.root.list("TypeDefinitions", "SimpleType");
    unique(types(), "type", findings);
    let mut items = Items::new();
    for defined in types() {
        if let (Some(name), Some(value)) = (defined.attribute("name"), defined.children.first()) {
            bounds(value, &place(value), None, findings);
            items.insert(name, enumeration(value, findings));
        }
    }
    for (_, variable) in model.variables() {
        declared_type(variable, findings);
        if matches!(
            variable.kind,
            Kind::Real | Kind::Integer | Kind::Enumeration
        ) {
            bounds(
                variable.value,
                &variable.place(),
                variable.of_type,
                findings,
            );
        }
        if variable.kind == Kind::Enumeration {
            start_item(variable, &items, findings);
        }
    }
}

/// Checks that min <= start <= max, where a variable has what its type has unless it says other.
fn bounds(
    value: &Element<'_>,
    place: &str,
    of_type: Option<&Element<'_>>,
    findings: &mut Findings,
) {
    let number = |name: &str| {
        let own = value.attribute(name);
        own.or_else(|| of_type?.attribute(name)).and_then(real)
    };
    let (min, max) = (number("min"), number("max"));
    if let (Some(min), Some(max)) = (min, max)
        && (min > max || min.is_nan() || max.is_nan())
    {
        findings.error(
            place,
            format!("min is {min} and max is {max}, expected min <= max"),
        );
    }
    let Some(start) = value.attribute("start").and_then(real) else {
        return;
    };
    if value.name == "Real" && !start.is_finite() {
        findings.warning(place, format!("start is {start}, expected a finite number"));
    }
    if min.is_some_and(|min| start < min) || max.is_some_and(|max| start > max) {
        let bound = |bound: Option<f64>| bound.map_or("none".into(), |bound| bound.to_string());
        findings.error(
            place,
            format!(
                "start is {start}, expected it from min {} to max {}",
                bound(min),
                bound(max)
            ),
        );
    }
}

/// Checks the items of an enumeration, and returns their values.
fn enumeration(value: &Element<'_>, findings: &mut Findings) -> HashSet<i32> {
    let items = || value.children.iter().filter(|child| child.name == "Item");
    unique(items(), "item", findings);
    let mut values = HashSet::new();
    for item in items() {
        if let Some(number) = item.attribute("value").and_then(integer)
            && !values.insert(number)
        {
            findings.error(
                place(item),
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
    let is = match variable.of_type {
        Some(of_type) if of_type.name == variable.value.name => return,
        Some(of_type) => format!(
            "is {}, expected {}",
            quote(of_type.name),
            variable.value.name
        ),
        None => "is not defined, expected one of TypeDefinitions".into(),
    };
    findings.error(
        variable.place(),
        format!("the type {} {is}", quote(declared)),
    );
}

/// Checks that the start value of an enumeration is one of its items.
fn start_item(variable: &Variable<'_>, items: &Items<'_>, findings: &mut Findings) {
    let declared = variable.value.attribute("declaredType");
    let (Some(start), Some(items)) = (
        variable.start().and_then(integer),
        declared.and_then(|name| items.get(name)),
    ) else {
        return;
    };
    if !items.contains(&start) {
        findings.error(
            variable.place(),
            format!("start is {start}, expected the value of an item of its type"),
        );
    }
}
