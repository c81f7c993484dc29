//! The rules for a model description that its schema does not express.

mod arrays;
mod clocks;
mod definitions;
mod structure;
mod variables;

use std::collections::HashSet;

use fmu_description::value::whole;
use fmu_description::words::is_identifier;
use fmu_description::xml::Element;
use fmu_description::{FmiVersion, ModelDescription, Variability, XmlVariable};
use fmu_file::text::quote;

use crate::finding::{Findings, Location, find, require};
use crate::package::{INTERFACES, interfaces};
use crate::rule::{Rule, rule};

/// A model description that is checked.
pub struct Check<'a> {
    model: &'a ModelDescription<'a>,
    /// The indices of the states: the variables of which other variables are derivatives.
    states: HashSet<usize>,
    findings: &'a mut Findings,
}

/// Applies the rules of FMI 2.0.5 and FMI 3.0.2 for a model description that its schema does not express.
pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    let states = model.variables().filter_map(|(_, v)| state_of(v, model));
    let states = states.collect();
    let mut check = Check { model, states, findings };
    check.root();
    check.units();
    check.types();
    check.names();
    check.variables();
    check.structure();
    if check.is_3() {
        for (_, variable) in model.variables() {
            check.start_size(variable);
            check.elements(variable);
        }
        check.clocks();
    }
}

/// The index of the state that a variable is the derivative of.
pub fn state_of(variable: &XmlVariable<'_>, model: &ModelDescription<'_>) -> Option<usize> {
    model.index(whole(variable.value.attribute("derivative")?)?)
}

pub fn is_clocked(variable: &XmlVariable<'_>) -> bool {
    variable.element.has("clocks")
}

pub fn is_continuous(variable: &XmlVariable<'_>) -> bool {
    variable.variability == Variability::Continuous
}

/// Whether it has a start value, which may be an empty text.
pub fn has_start(variable: &XmlVariable<'_>) -> bool {
    variable.start().is_some() || variable.value.child("Start").is_some()
}

impl<'a> Check<'a> {
    fn is_3(&self) -> bool {
        self.model.version == FmiVersion::Fmi3
    }

    fn add(&mut self, rule: &'static Rule, place: impl Into<Location>, text: impl AsRef<str>) {
        self.findings.add(rule, place, text);
    }

    /// The names of the types of real numbers, for messages.
    fn float(&self) -> &'static str {
        match self.model.version {
            FmiVersion::Fmi2 => "Real",
            FmiVersion::Fmi3 => "Float32 or Float64",
        }
    }

    /// The element that refers to a variable, for messages.
    fn reference(&self) -> String {
        match self.model.version {
            FmiVersion::Fmi2 => {
                let number = self.model.variables.len();
                format!("the index of a variable, 1 to {number}")
            }
            FmiVersion::Fmi3 => "the value reference of a variable".into(),
        }
    }

    /// Collects the names of elements, which must be unique.
    fn unique<'b>(
        &mut self,
        elements: impl Iterator<Item = &'b Element<'b>>,
        what: &str,
    ) -> HashSet<&'b str> {
        let mut names = HashSet::new();
        for element in elements {
            if let Some(name) = element.attribute("name") {
                require!(self, "definition-named" at element, !name.is_empty(),
                    "the name of a {what} is empty, expected a string");
                require!(self, "definition-unique" at element, names.insert(name),
                    "the {what} {} is defined twice, expected each name once", quote(name));
            }
        }
        names
    }
}

/// The root, the interface types and the default experiment.
impl Check<'_> {
    fn root(&mut self) {
        let root = self.model.root;
        let [token, get_state, serialize] = match self.model.version {
            FmiVersion::Fmi2 => ["guid", "canGetAndSetFMUstate", "canSerializeFMUstate"],
            FmiVersion::Fmi3 => {
                ["instantiationToken", "canGetAndSetFMUState", "canSerializeFMUState"]
            }
        };
        let rule = match self.model.version {
            FmiVersion::Fmi2 => rule!("name-and-guid"),
            FmiVersion::Fmi3 => rule!("name-and-token"),
        };
        for name in ["modelName", token] {
            if root.attribute(name).is_some_and(|text| text.trim().is_empty()) {
                self.add(rule, root, format!("{name} is empty, expected a string"));
            }
        }
        if let Some(date) = root.attribute("generationDateAndTime") {
            require!(self, "generation-utc" at root, date.trim().ends_with('Z'),
                "generationDateAndTime is {}, expected a time in UTC, which ends in Z", quote(date));
        }
        self.unique(root.list("LogCategories", "Category"), "log category");
        self.unique(root.list("VendorAnnotations", "Tool"), "tool");
        if self.is_3() {
            require!(self, "interface-given" at root, interfaces(root).next().is_some(),
                "it has no interface type, expected ModelExchange, CoSimulation or \
                 ScheduledExecution");
        } else {
            // The schema of FMI 3.0 requires it.
            for kind in INTERFACES {
                if let Some(second) = root.children(kind).nth(1) {
                    find!(self, "interface-once" at second, "{kind} appears twice, expected it once");
                }
            }
            let is_exchange = self.model.model_exchange().is_some();
            require!(self, "event-indicators" at root,
                !is_exchange || root.has("numberOfEventIndicators"),
                "numberOfEventIndicators is missing, expected it for model exchange");
        }
        let early = ["canReturnEarlyAfterIntermediateUpdate", "providesIntermediateUpdate"];
        for interface in interfaces(root) {
            if let Some(identifier) = interface.attribute("modelIdentifier") {
                require!(self, "model-identifier" at interface, is_identifier(identifier),
                    "modelIdentifier is {}, expected a C identifier", quote(identifier));
            }
            for (rule, [flag, needed]) in [
                (rule!("serialize-needs-get"), [serialize, get_state]),
                (rule!("early-return"), early),
            ] {
                if interface.is_true(flag) && !interface.is_true(needed) {
                    let text = format!("{flag} is true, expected {needed} to be true with it");
                    self.add(rule, interface, text);
                }
            }
            let step = interface.real("fixedInternalStepSize").unwrap_or(1.0);
            require!(self, "internal-step" at interface, step > 0.0 && step.is_finite(),
                "fixedInternalStepSize is {step}, expected a positive number");
        }
        if let Some(element) = root.child("DefaultExperiment") {
            self.experiment(element);
        }
    }

    fn experiment(&mut self, element: &Element<'_>) {
        for (name, above, expected) in [
            ("startTime", f64::NEG_INFINITY, "a finite number"),
            ("stopTime", f64::NEG_INFINITY, "a finite number"),
            ("tolerance", 0.0, "a positive number"),
            ("stepSize", 0.0, "a positive number"),
        ] {
            let value = element.real(name).unwrap_or(1.0);
            require!(self, "experiment-numbers" at element, value.is_finite() && value > above,
                "{name} is {value}, expected {expected}");
        }
        let start = element.real("startTime").unwrap_or(0.0);
        if let Some(stop) = element.real("stopTime") {
            let (span, step) = (stop - start, element.real("stepSize").unwrap_or(0.0));
            require!(self, "stop-after-start" at element, stop > start,
                "stopTime is {stop}, expected it after startTime {start}");
            require!(self, "step-in-experiment" at element,
                span <= 0.0 || step <= span * (1.0 + 1e-9),
                "stepSize is {step}, expected at most stopTime - startTime = {span}");
        }
    }
}
