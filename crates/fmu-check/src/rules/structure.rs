//! The model structure (FMI 2.0.5, section 2.2.8; FMI 3.0.2, section 2.4.8).

use std::collections::HashSet;

use fmu_description::value::items;
use fmu_description::xml::Element;
use fmu_description::{Causality, FmiVersion, Initial, Type, Unknown, Variability, XmlVariable};
use fmu_file::text::quote;

use super::{Check, is_clocked, is_continuous, state_of};
use crate::finding::{find, require};
use crate::rule::{Rule, rule};

impl Check<'_> {
    pub(super) fn structure(&mut self) {
        let model = self.model;
        let [outputs_name, derivatives_name, initial_name] = match model.version {
            FmiVersion::Fmi2 => ["Outputs", "Derivatives", "InitialUnknowns"],
            FmiVersion::Fmi3 => ["Output", "ContinuousStateDerivative", "InitialUnknown"],
        };
        for (name, unknowns) in [
            (outputs_name, &model.outputs),
            (derivatives_name, &model.derivatives),
            ("ClockedState", &model.clocked_states),
            (initial_name, &model.initial_unknowns),
            ("EventIndicator", &model.event_indicators),
        ] {
            self.each(name, unknowns);
        }
        // An FMU for co-simulation may hide its states, so that nothing is known about its variables.
        if !model.derivatives.is_empty() || model.model_exchange().is_some() {
            let states = self.states.clone();
            let is_known = |index: usize, v: &XmlVariable<'_>| {
                let is_computed = matches!(v.causality, Causality::Local | Causality::Output);
                !is_computed
                    || !is_continuous(v)
                    || !v.of_type.is_float()
                    || states.contains(&index)
            };
            let expected = "inputs, states and the independent variable";
            for list in [&model.outputs, &model.derivatives, &model.event_indicators] {
                self.dependencies(list, rule!("dependency-known"), is_known, expected);
            }
        }
        let listed = indices(&model.outputs);
        for (index, variable) in model.variables() {
            let is_output = variable.causality == Causality::Output;
            let is_listed = listed.contains(&index);
            require!(self, "outputs-listed" at variable, !is_output || is_listed,
                "the output is not in {outputs_name} of ModelStructure, expected it there");
            require!(self, "only-outputs-listed" at variable, is_output || !is_listed,
                "it is in {outputs_name} of ModelStructure, expected outputs only");
        }
        self.derivatives(derivatives_name);
        self.clocked_states_and_indicators();
        self.initial_unknowns(initial_name);
    }

    /// Checks the references and dependencies of the unknowns in a list.
    fn each(&mut self, list: &str, unknowns: &[Unknown<'_>]) {
        let reference = match self.model.version {
            FmiVersion::Fmi2 => "index",
            FmiVersion::Fmi3 => "value reference",
        };
        let mut seen = HashSet::new();
        for unknown in unknowns {
            let (at, number) = (unknown.element, unknown.number);
            require!(self, "index-exists" at at, unknown.index.is_some(),
                "{list} has the {reference} {number}, expected {}", self.reference());
            require!(self, "index-once" at at, seen.insert(number),
                "{list} has the {reference} {number} twice, expected it once");
            let dependencies = unknown.dependencies.as_deref().unwrap_or_default();
            let is_wrong = |number: &&u32| self.model.index(**number).is_none();
            if let Some(wrong) = dependencies.iter().find(is_wrong) {
                find!(self, "dependency-exists" at at,
                    "dependencies has {wrong}, expected {}", self.reference());
            }
            if !self.is_3() {
                let different: HashSet<_> = dependencies.iter().collect();
                require!(self, "dependency-once" at at, different.len() == dependencies.len(),
                    "dependencies has an index twice, expected each once");
                let mut pairs = dependencies.windows(2);
                if let Some([first, second]) = pairs.find(|pair| pair[0] > pair[1]) {
                    find!(self, "dependency-order" at at,
                        "dependencies has {second} after {first}, expected ascending order");
                }
            }
            if let Some(kinds) = at.attribute("dependenciesKind") {
                self.kinds(list, unknown, kinds);
            }
        }
    }

    /// Checks the kinds of the dependencies of an unknown.
    fn kinds(&mut self, list: &str, unknown: &Unknown<'_>, kinds: &str) {
        let (at, count) = (unknown.element, items(kinds).count());
        match unknown.dependencies.as_ref().map(Vec::len) {
            None => find!(self, "dependency-kinds" at at,
                "dependenciesKind is given without dependencies, expected both"),
            Some(all) => require!(self, "dependency-kinds" at at, all == count,
                "dependenciesKind has {count} items, expected {all}, one per dependency"),
        }
        let variable = self.model.variable(unknown.index);
        if variable.is_some_and(|v| !v.of_type.is_float())
            && let Some(kind) = items(kinds).find(|kind| *kind != "dependent")
        {
            find!(self, "dependency-kind-real" at at,
                "dependenciesKind has {}, expected dependent for what is not a {}",
                quote(kind), self.float());
        }
        if list.starts_with("InitialUnknown")
            && let Some(kind) = items(kinds).find(|kind| !matches!(*kind, "dependent" | "constant"))
        {
            find!(self, "initial-kinds" at at,
                "dependenciesKind has {}, expected dependent or constant", quote(kind));
        }
    }

    /// Checks that unknowns depend only on what is known.
    fn dependencies(
        &mut self,
        unknowns: &[Unknown<'_>],
        rule: &'static Rule,
        is_known: impl Fn(usize, &XmlVariable<'_>) -> bool,
        expected: &str,
    ) {
        let model = self.model;
        let other = |number: &u32| {
            let index = model.index(*number)?;
            model.variable(index).filter(|v| !is_known(index, v))
        };
        for unknown in unknowns {
            let mut others = unknown.dependencies.iter().flatten().filter_map(other);
            if let Some(other) = others.next() {
                let name = quote(&other.name);
                let text =
                    format!("dependencies has {name}, which is computed, expected {expected}");
                self.add(rule, unknown.element, text);
            }
        }
    }

    fn derivatives(&mut self, list: &str) {
        /// The dimensions of a variable, each a number or a value reference.
        fn sizes<'a>(variable: &XmlVariable<'a>) -> Vec<[Option<&'a str>; 2]> {
            let size =
                |d: &'a Element<'a>| ["start", "valueReference"].map(|name| d.attribute(name));
            (variable.element.children("Dimension")).map(size).collect()
        }
        let model = self.model;
        let mut states = HashSet::new();
        for unknown in &model.derivatives {
            let Some(variable) = model.variable(unknown.index) else { continue };
            let is_derivative = variable.value.has("derivative");
            require!(self, "derivative-attribute" at variable, is_derivative,
                "it is in {list} of ModelStructure, expected it to have the attribute derivative");
            require!(self, "derivative-continuous" at variable, is_continuous(variable) || !is_derivative,
                "it is in {list} of ModelStructure, expected its variability to be continuous");
            let index = state_of(variable, model);
            let Some(state) = model.variable(index) else { continue };
            let name = quote(&state.name);
            require!(self, "derivative-once" at variable,
                index != unknown.index && states.insert(index),
                "it is in {list} of ModelStructure as derivative of {name}, expected a state that has no \
                 other derivative there");
            if self.is_3() {
                self.state_causality(state, "the state");
                require!(self, "derivative-size" at variable, sizes(variable) == sizes(state),
                    "it is the derivative of {name}, expected the same dimensions");
            }
        }
    }

    /// Checks that a state or event indicator is computed by the FMU.
    fn state_causality(&mut self, variable: &XmlVariable<'_>, what: &str) {
        let causality = variable.causality;
        require!(self, "state-causality" at variable,
            matches!(causality, Causality::Local | Causality::Output),
            "{what} has causality {}, expected local or output", causality.as_str());
    }

    fn clocked_states_and_indicators(&mut self) {
        let model = self.model;
        for variable in (model.clocked_states.iter()).filter_map(|u| model.variable(u.index)) {
            let is_discrete = variable.variability == Variability::Discrete;
            let has_previous = variable.element.has("previous");
            require!(self, "clocked-state" at variable,
                has_previous && is_clocked(variable) && is_discrete,
                "it is in ClockedState, expected it to be discrete and to have the attributes clocks and \
                 previous");
        }
        for variable in (model.event_indicators.iter()).filter_map(|u| model.variable(u.index)) {
            require!(self, "indicator-continuous" at variable,
                variable.of_type.is_float() && is_continuous(variable),
                "it is in EventIndicator, expected a continuous {}", self.float());
            self.state_causality(variable, "the event indicator");
        }
    }

    /// Checks that `InitialUnknowns` lists exactly the variables that are computed during initialization.
    fn initial_unknowns(&mut self, list: &str) {
        let (model, unknowns) = (self.model, &self.model.initial_unknowns);
        let mut pairs = unknowns.windows(2);
        let descent = pairs.find(|pair| pair[0].number > pair[1].number);
        if let Some([first, second]) = descent.filter(|_| !self.is_3()) {
            find!(self, "initial-unknowns-order" at second.element,
                "InitialUnknowns has the index {} after {}, expected ascending order",
                second.number, first.number);
        }
        let is_known = |_, v: &XmlVariable<'_>| {
            let is_given = matches!(v.causality, Causality::Input | Causality::Independent);
            is_given
                || v.initial == Some(Initial::Exact)
                || v.of_type == Type::Clock
                || is_clocked(v)
        };
        let expected = "inputs, the independent variable, and variables with initial exact";
        self.dependencies(unknowns, rule!("initial-known"), is_known, expected);
        let listed = indices(unknowns);
        let mut of_states = indices(&model.derivatives);
        for unknown in &model.derivatives {
            of_states.extend((model.variable(unknown.index)).and_then(|v| state_of(v, model)));
        }
        // An FMU may or may not initialize its clocked variables.
        for (index, variable) in model.variables().filter(|(_, v)| !is_clocked(v)) {
            let initial = variable.initial;
            let is_computed = matches!(initial, Some(Initial::Approx | Initial::Calculated));
            let is_unknown = match variable.causality {
                Causality::CalculatedParameter => true,
                Causality::Output => is_computed,
                _ => is_computed && of_states.contains(&index),
            };
            let is_listed = listed.contains(&index);
            require!(self, "initial-unknowns-listed" at variable, is_listed || !is_unknown,
                "it is computed during initialization but not in {list} of ModelStructure, expected it \
                 there");
            require!(self, "only-initial-unknowns-listed" at variable, is_unknown || !is_listed,
                "it is in {list} of ModelStructure, expected outputs, calculated parameters, states and \
                 derivatives that are computed");
        }
    }
}

pub fn indices(unknowns: &[Unknown<'_>]) -> HashSet<usize> {
    unknowns.iter().filter_map(|u| u.index).collect()
}
