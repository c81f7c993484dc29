//! What FMI 3.0 adds: arrays, structural parameters, clocks and clocked variables.

use std::collections::HashSet;

use fmu_description::value::{items, whole};
use fmu_description::xml::Element;
use fmu_description::{Causality, Type, Variability, XmlVariable};

use super::{Check, is_clocked, is_continuous};
use crate::finding::{Location, find, require};

impl Check<'_> {
    /// Checks the number of bytes of the start values of a Binary.
    pub(super) fn start_size(&mut self, variable: &XmlVariable<'_>) {
        let max = variable.inherited("maxSize").and_then(whole);
        let max = max.unwrap_or(u32::MAX);
        for start in variable.element.children("Start") {
            // Two digits a byte.
            let size = start.attribute("value").unwrap_or_default().trim().len() / 2;
            require!(self, "start-size" at variable, size <= max as usize,
                "its start value has {size} bytes, expected at most maxSize = {max}");
        }
    }

    /// Checks the dimensions of a variable, and how many start values it has.
    pub(super) fn elements(&mut self, variable: &XmlVariable<'_>) {
        let element = variable.element;
        if variable.causality == Causality::StructuralParameter
            && let Some(dimension) = element.child("Dimension")
        {
            find!(self, "structural-scalar" at dimension,
                "the structural parameter has a Dimension, expected none");
        }
        let mut size = Some(1_u64);
        for dimension in element.children("Dimension") {
            let pair = size.zip(self.length(dimension));
            size = pair.and_then(|(a, b)| a.checked_mul(b));
            require!(self, "array-size" at variable, pair.is_none() || size.is_some(),
                "its dimensions have more elements than a computer can address");
        }
        let is_list = matches!(variable.of_type, Type::String | Type::Binary);
        let starts = match is_list {
            true => element.children("Start").count(),
            false => element.attribute("start").map_or(1, |start| items(start).count()),
        };
        if let Some(size) = size {
            let fits = starts == 1 || starts as u64 == size || is_list && starts == 0;
            let or_more = match size {
                1 => String::new(),
                size => format!(" or {size}"),
            };
            require!(self, "start-count" at variable, fits,
                "it has {starts} start values, expected 1{or_more}");
        }
    }

    /// The initial size of a dimension, if it is valid.
    fn length(&mut self, dimension: &Element<'_>) -> Option<u64> {
        let is_size = |v: &&XmlVariable<'_>| {
            let is_structural = v.causality == Causality::StructuralParameter;
            v.of_type == Type::UInt64 && (is_structural || v.variability == Variability::Constant)
        };
        let start = match ["start", "valueReference"].map(|name| dimension.attribute(name)) {
            [Some(start), None] => start,
            [None, Some(reference)] => {
                let referred = self.model.referred(dimension, "valueReference");
                let Some(size) = referred.filter(is_size) else {
                    find!(self, "dimension-reference" at dimension,
                        "valueReference of the Dimension is {reference}, expected that of a UInt64 that \
                         is a constant or a structural parameter");
                    return None;
                };
                size.start()?
            }
            [start, _] => {
                let both = match start {
                    Some(_) => "both start and",
                    None => "neither start nor",
                };
                find!(self, "dimension-size" at dimension,
                    "the Dimension has {both} valueReference, expected one of them");
                return None;
            }
        };
        let length = whole(start)?;
        require!(self, "dimension-positive" at dimension, length > 0,
            "the initial size of the Dimension is 0, expected a positive number");
        Some(length)
    }

    pub(super) fn clocks(&mut self) {
        let model = self.model;
        let has_clocks = model.variables().any(|(_, v)| v.of_type == Type::Clock);
        for interface in model.root.children("CoSimulation") {
            require!(self, "clocks-need-events" at interface,
                !has_clocks || interface.is_true("hasEventMode"),
                "the FMU has clocks, expected hasEventMode = true");
        }
        for defined in model.root.list("TypeDefinitions", "ClockType") {
            self.interval(defined, None);
        }
        let mut previous = HashSet::new();
        for (_, variable) in model.variables() {
            if variable.of_type == Type::Clock {
                self.clock(variable);
            }
            self.clocked(variable);
            if let Some(reference) = variable.element.attribute("previous") {
                let is_first = previous.insert(reference.trim());
                self.previous(variable, reference, is_first);
            }
        }
    }

    fn clock(&mut self, variable: &XmlVariable<'_>) {
        use Causality::{Input, Local, Output};
        let (clock, causality) = (variable.element, variable.causality);
        require!(self, "clock-causality" at variable, matches!(causality, Input | Output | Local),
            "the clock has causality {}, expected input, output or local", causality.as_str());
        self.interval(clock, variable.declared);
        require!(self, "clock-priority" at variable, causality != Output || !clock.has("priority"),
            "the output has a priority, expected none");
        let needs_one = causality == Input && self.model.scheduled_execution().is_some();
        require!(self, "clock-priority" at variable,
            !needs_one || variable.inherited("priority").is_some(),
            "it has no priority, expected one in Scheduled Execution");
    }

    /// Checks the clocks of a variable, and the variability of clocks and clocked variables.
    fn clocked(&mut self, variable: &XmlVariable<'_>) {
        let model = self.model;
        let clocks = variable.element.attribute("clocks");
        let is_clock = variable.of_type == Type::Clock;
        let (what, expected) =
            if is_clock { ("a clock", "discrete") } else { ("clocked", "discrete or tunable") };
        let fits = match variable.variability {
            Variability::Discrete => true,
            Variability::Tunable => !is_clock,
            _ => !is_clock && clocks.is_none(),
        };
        require!(self, "clocked-variability" at variable, fits,
            "it is {what} with variability {}, expected {expected}", variable.variability.as_str());
        require!(self, "clocks-exist" at variable,
            clocks.is_none_or(|all| items(all).next().is_some()),
            "clocks is empty, expected value references of clocks");
        for clock in items(clocks.unwrap_or_default()) {
            let of = whole(clock).and_then(|number| model.variable(model.index(number)));
            require!(self, "clocks-exist" at variable, of.is_some_and(|of| of.of_type == Type::Clock),
                "clocks has {clock}, expected value references of clocks");
        }
        let is_updated = variable.element.is_true("intermediateUpdate");
        require!(self, "intermediate-update" at variable, !is_updated || is_continuous(variable),
            "it has intermediateUpdate = true, expected it only for continuous variables");
    }

    fn previous(&mut self, variable: &XmlVariable<'_>, reference: &str, is_first: bool) {
        let is_discrete = |v: &XmlVariable<'_>| v.variability == Variability::Discrete;
        require!(self, "previous-clocked" at variable, is_clocked(variable) && is_discrete(variable),
            "it has previous, expected it only for discrete variables with clocks");
        let kind = variable.value.name;
        let fits = |before: &XmlVariable<'_>| {
            let is_other = before.reference != variable.reference;
            let is_computed = before.causality != Causality::Input;
            is_other && before.value.name == kind && is_discrete(before) && is_computed
        };
        let before = self.model.referred(variable.element, "previous");
        require!(self, "previous-reference" at variable, before.is_some_and(fits) && is_first,
            "previous is {reference}, expected the value reference of another discrete {kind} that is not \
             an input and is not the previous of any other variable");
    }

    /// Checks when a clock ticks; a variable inherits from its declared type.
    fn interval(&mut self, clock: &Element<'_>, declared: Option<&Element<'_>>) {
        let at = || Location::of_variable(clock);
        let has = |name| clock.has(name) || declared.is_some_and(|declared| declared.has(name));
        for (name, may_be_zero, expected) in [
            ("intervalDecimal", false, "a positive number"),
            ("intervalCounter", false, "a positive number"),
            ("resolution", false, "a positive number"),
            ("shiftDecimal", true, "0 or more"),
        ] {
            let value = clock.real(name).unwrap_or(1.0);
            let fits = value.is_finite() && (value > 0.0 || may_be_zero && value == 0.0);
            require!(self, "clock-interval" at at(), fits,
                "{name} is {value}, expected {expected}");
        }
        let variability = clock.attribute("intervalVariability").unwrap_or_default();
        require!(self, "clock-interval-given" at at(),
            variability != "constant" || has("intervalDecimal"),
            "the clock is constant and has no intervalDecimal, expected one");
        let is_periodic = !matches!(variability, "changing" | "countdown" | "triggered");
        for name in ["intervalDecimal", "intervalCounter", "resolution"] {
            require!(self, "clock-periodic" at at(), is_periodic || !clock.has(name),
                "it has {name} and intervalVariability {variability}, expected {name} only for periodic \
                 clocks");
        }
        for [shift, interval] in
            [["shiftDecimal", "intervalDecimal"], ["shiftCounter", "intervalCounter"]]
        {
            require!(self, "clock-shift" at at(), !clock.has(shift) || has(interval),
                "it has {shift} and no {interval}, expected both");
        }
        let own = clock.has("supportsFraction");
        let supports = declared.filter(|_| !own).unwrap_or(clock);
        require!(self, "clock-fraction" at at(),
            !clock.has("intervalCounter") || supports.is_true("supportsFraction") && has("resolution"),
            "it has intervalCounter, expected a resolution and supportsFraction = true with it");
    }
}
