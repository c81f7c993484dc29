//! Clocks and clocked variables (FMI 3.0.2, sections 2.2.8, 2.4.4 and 2.4.7.4).

use std::collections::HashSet;

use fmu_description::value::{items, whole};
use fmu_description::xml::Element;
use fmu_description::{Causality, Type, Variability, XmlVariable};
use fmu_file::text::quote;

use super::{Check, is_clocked, is_continuous};
use crate::finding::{Location, require};

impl Check<'_> {
    pub(super) fn clocks(&mut self) {
        let model = self.model;
        let mut clocks = model.variables().filter(|(_, v)| v.of_type == Type::Clock).peekable();
        let has_clocks = clocks.peek().is_some();
        for interface in model.root.children("CoSimulation") {
            require!(self, "clocks-need-events" at interface,
                !has_clocks || interface.is_true("hasEventMode"),
                "the FMU has clocks, expected hasEventMode = true");
        }
        if let Some(scheduled) = model.scheduled_execution() {
            let has_partition = clocks.any(|(_, clock)| clock.causality == Causality::Input);
            require!(self, "partition-given" at scheduled, has_partition,
                "the FMU has no input clock, expected one for each model partition");
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
        self.clocked_dependencies();
    }

    fn clock(&mut self, variable: &XmlVariable<'_>) {
        use Causality::{Input, Local, Output};
        let (clock, causality) = (variable.element, variable.causality);
        require!(self, "clock-causality" at variable, matches!(causality, Input | Output | Local),
            "the clock has causality {}, expected input, output or local", causality.as_str());
        self.interval(clock, variable.declared);
        let kind = clock.attribute("intervalVariability").unwrap_or("triggered");
        require!(self, "clock-triggered" at variable,
            kind == "triggered" || !matches!(causality, Output | Local),
            "it is {} with intervalVariability {}, expected triggered", causality.as_str(), quote(kind));
        require!(self, "clock-priority" at variable, causality != Output || !clock.has("priority"),
            "the output has a priority, expected none");
        let is_scheduled = self.model.scheduled_execution().is_some();
        require!(self, "clock-priority" at variable,
            causality != Input || !is_scheduled || variable.inherited("priority").is_some(),
            "it has no priority, expected one in Scheduled Execution");
        require!(self, "clock-local" at variable, causality != Local || !is_scheduled,
            "the clock is local, expected an input or output in Scheduled Execution");
        require!(self, "clock-flags" at variable,
            causality == Input || !clock.is_true("canBeDeactivated"),
            "it has canBeDeactivated = true, expected it only for inputs");
        require!(self, "clock-flags" at variable,
            kind != "triggered" || !clock.is_true("supportsFraction"),
            "it is triggered and has supportsFraction = true, expected it only for time-based clocks");
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
        let mut are_local = clocks.is_some();
        for clock in items(clocks.unwrap_or_default()) {
            let of = whole(clock).and_then(|number| model.variable(model.index(number)));
            let of = of.filter(|of| of.of_type == Type::Clock);
            require!(self, "clocks-exist" at variable, of.is_some(),
                "clocks has {clock}, expected value references of clocks");
            are_local &= of.is_some_and(|of| of.causality == Causality::Local);
        }
        require!(self, "clock-local" at variable,
            !are_local || variable.causality == Causality::Local,
            "it is {} and has local clocks only, expected a local variable",
            variable.causality.as_str());
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
        let states = &self.model.clocked_states;
        require!(self, "clocked-states-listed" at variable,
            states.iter().any(|state| state.number == variable.reference),
            "it has previous and is not in ClockedState of ModelStructure, expected it there");
    }

    /// Checks that the dependencies of clocked outputs have their input clocks.
    fn clocked_dependencies(&mut self) {
        let model = self.model;
        for output in &model.outputs {
            let Some(variable) = model.variable(output.index) else { continue };
            let Some(dependencies) = &output.dependencies else { continue };
            for clock in items(variable.element.attribute("clocks").unwrap_or_default()) {
                let clock = whole(clock).and_then(|number| model.variable(model.index(number)));
                let Some(clock) = clock.filter(|clock| clock.causality == Causality::Input) else {
                    continue;
                };
                require!(self, "clocked-dependencies" at output.element,
                    dependencies.contains(&clock.reference),
                    "the dependencies of {} lack its clock {}, expected all of its input clocks",
                    quote(&variable.name), quote(&clock.name));
            }
        }
    }

    /// Checks when a clock ticks; a variable inherits from its declared type.
    fn interval(&mut self, clock: &Element<'_>, declared: Option<&Element<'_>>) {
        /// Decimals may be written with single precision.
        const ROUNDING: f64 = 1e-6;
        let at = || Location::of_variable(clock);
        let of = |name| match clock.has(name) {
            true => Some(clock),
            false => declared.filter(|declared| declared.has(name)),
        };
        let real = |name| of(name).and_then(|of| of.real(name));
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
            variability != "constant" || of("intervalDecimal").is_some(),
            "the clock is constant and has no intervalDecimal, expected one");
        let is_periodic = !matches!(variability, "changing" | "countdown" | "triggered");
        for name in ["intervalDecimal", "intervalCounter", "resolution"] {
            require!(self, "clock-periodic" at at(), is_periodic || !clock.has(name),
                "it has {name} and intervalVariability {variability}, expected {name} only for periodic \
                 clocks");
        }
        let supports = of("supportsFraction").is_some_and(|of| of.is_true("supportsFraction"));
        let has_counter = of("intervalCounter").is_some();
        for [shift, interval] in
            [["shiftDecimal", "intervalDecimal"], ["shiftCounter", "intervalCounter"]]
        {
            require!(self, "clock-shift" at at(), !clock.has(shift) || of(interval).is_some(),
                "it has {shift} and no {interval}, expected both");
        }
        require!(self, "clock-fraction" at at(),
            !clock.has("intervalCounter") || supports && of("resolution").is_some(),
            "it has intervalCounter, expected a resolution and supportsFraction = true with it");
        require!(self, "clock-fraction-given" at at(),
            variability != "constant" || !supports || has_counter,
            "the clock is constant, has supportsFraction = true and no intervalCounter, expected one");
        let resolution = real("resolution").filter(|number| *number > 0.0);
        for (decimal, counter) in
            [("intervalDecimal", "intervalCounter"), ("shiftDecimal", "shiftCounter")]
        {
            if let (Some(resolution), Some(ticks), Some(time)) =
                (resolution, real(counter), real(decimal))
            {
                let expected = ticks / resolution;
                require!(self, "clock-fraction-agrees" at at(),
                    !time.is_finite() || (time - expected).abs() <= ROUNDING * expected.abs(),
                    "{decimal} is {time}, expected {expected} as {counter} / resolution");
            }
        }
    }
}
