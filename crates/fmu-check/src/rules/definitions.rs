//! Units and types, and what uses them: bounds, start values and display units.

use std::collections::{HashMap, HashSet};

use fmu_description::value::{items, real, whole};
use fmu_description::xml::Element;
use fmu_description::{Type, XmlVariable};
use fmu_file::text::quote;

use super::Check;
use crate::finding::{Location, find, require};

/// The display units of each unit, by unit name.
type Units<'a> = HashMap<&'a str, HashSet<&'a str>>;
/// The item values of each enumeration type, by type name.
type Items<'a> = HashMap<&'a str, HashSet<i64>>;

impl<'a> Check<'a> {
    pub(super) fn units(&mut self) {
        let defined = || self.model.root.list("UnitDefinitions", "Unit");
        self.unique(defined(), "unit");
        let mut units = Units::new();
        for unit in defined() {
            for child in &unit.children {
                // Whether a base unit or display unit can be converted.
                let factor = child.real("factor").unwrap_or(1.0);
                let offset = child.real("offset").unwrap_or(0.0);
                require!(self, "inverse-offset" at child, !child.is_true("inverse") || offset == 0.0,
                    "the offset of an inverse unit is {offset}, expected 0");
                require!(self, "unit-factor" at child, factor != 0.0 && factor.is_finite(),
                    "the factor of a unit is {factor}, expected a number other than 0");
                require!(self, "unit-offset" at child, offset.is_finite(),
                    "the offset of a unit is {offset}, expected a finite number");
            }
            let displays = self.unique(unit.children("DisplayUnit"), "display unit");
            units.extend(unit.attribute("name").map(|name| (name, displays)));
        }
        for (_, value) in self.model.types() {
            if matches!(value.name, "Real" | "Float32Type" | "Float64Type") {
                self.usage(value, value.attribute("unit"), &units);
            }
        }
        for (_, variable) in self.model.variables().filter(|(_, v)| v.of_type.is_float()) {
            let aliases = variable.value.children("Alias");
            for element in [variable.value].into_iter().chain(aliases) {
                self.usage(element, variable.inherited("unit"), &units);
            }
        }
    }

    /// Checks that the unit and the display unit of a type or variable are defined.
    fn usage(&mut self, value: &Element<'_>, unit: Option<&str>, units: &Units<'_>) {
        let displays = unit.and_then(|unit| units.get(unit));
        if let Some(own) = value.attribute("unit") {
            require!(self, "unit-defined" at value, displays.is_some(),
                "the unit {} is not defined, expected one of UnitDefinitions", quote(own));
        }
        if let Some(display) = value.attribute("displayUnit") {
            let shown = quote(display);
            require!(self, "display-unit-needs-unit" at value, unit.is_some(),
                "displayUnit is {shown} without a unit, expected both");
            let is_defined = displays.is_none_or(|displays| displays.contains(display));
            require!(self, "display-unit-defined" at value, is_defined || unit == Some(display),
                "the display unit {shown} is not defined for its unit, expected a DisplayUnit");
        }
    }

    pub(super) fn types(&mut self) {
        let model = self.model;
        self.unique(model.types().map(|(defined, _)| defined), "type");
        let mut items = Items::new();
        for (defined, value) in model.types() {
            if let Some(name) = defined.attribute("name") {
                self.bounds(value, value, None);
                self.unique(value.children("Item"), "item");
                let values = items.entry(name).or_default();
                values.clear();
                for item in value.children("Item") {
                    if let Some(number) = item.attribute("value").and_then(whole) {
                        require!(self, "item-values-unique" at item, values.insert(number),
                            "two items have the value {number}, expected each value once");
                    }
                }
            }
        }
        for (_, variable) in model.variables() {
            self.declared_type(variable, &items);
            require!(self, "type-name" at variable, !items.contains_key(variable.name.as_str()),
                "a type has the same name, expected another name");
            let (min, max) = variable.of_type.range();
            if variable.of_type.is_float() || min <= max {
                self.bounds(variable.value, variable, variable.declared);
            }
        }
    }

    /// Checks that min <= start <= max; a variable inherits the bounds of its type.
    pub(super) fn bounds(
        &mut self,
        value: &Element<'_>,
        at: impl Into<Location> + Copy,
        declared: Option<&Element<'_>>,
    ) {
        let of_type = |name| declared.and_then(|declared| declared.real(name));
        let nominal = value.real("nominal").unwrap_or(1.0);
        require!(self, "nominal" at at, nominal > 0.0 && nominal.is_finite(),
            "nominal is {nominal}, expected a positive number");
        let number = |name| value.attribute(name).map_or(of_type(name), real);
        let (min, max) = (number("min"), number("max"));
        for (name, own, sign) in [("min", min, -1.0), ("max", max, 1.0)] {
            if let (Some(own), Some(of_type)) = (own, of_type(name)) {
                require!(self, "bounds-of-type" at at, sign * own <= sign * of_type,
                    "{name} is {own}, expected it within {name} {of_type} of its type");
            }
        }
        if let (Some(min), Some(max)) = (min, max) {
            require!(self, "min-max" at at, min <= max,
                "min is {min} and max is {max}, expected min <= max");
        }
        let starts = || items(value.attribute("start").unwrap_or_default()).filter_map(real);
        if let Some(start) = starts().find(|start| !start.is_finite()) {
            find!(self, "start-finite" at at, "start is {start}, expected a finite number");
        }
        let is_outside =
            |s: &f64| min.is_some_and(|min| *s < min) || max.is_some_and(|max| *s > max);
        if let Some(start) = starts().find(is_outside) {
            let bound = |bound: Option<f64>| bound.map_or("none".into(), |bound| bound.to_string());
            find!(self, "start-in-bounds" at at,
                "start is {start}, expected it from min {} to max {}", bound(min), bound(max));
        }
    }

    /// Checks that the declared type of a variable is defined, and has its start value if it is an item.
    pub(super) fn declared_type(&mut self, variable: &XmlVariable<'_>, items: &Items<'_>) {
        let Some(declared) = variable.value.attribute("declaredType") else { return };
        let expected = variable.value.name;
        let fault = match variable.declared.map(|of_type| of_type.name) {
            Some(found) if found.strip_suffix("Type").unwrap_or(found) == expected => None,
            Some(found) => Some(format!("is {}, expected {expected}", quote(found))),
            None => Some("is not defined, expected one of TypeDefinitions".into()),
        };
        if let Some(is) = fault {
            find!(self, "declared-type" at variable, "the type {} {is}", quote(declared));
        }
        if let Some(items) = items.get(declared)
            && variable.of_type == Type::Enumeration
        {
            let mut starts = variable.starts().into_iter().filter_map(whole);
            if let Some(start) = starts.find(|start| !items.contains(start)) {
                find!(self, "start-is-item" at variable,
                    "start is {start}, expected the value of an item of its type");
            }
        }
    }
}
