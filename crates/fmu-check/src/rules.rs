//! The rules for a model description that its schema does not express.

use std::collections::{HashMap, HashSet};
use std::sync::LazyLock;

use fmu_description::value::{items, real, whole};
use fmu_description::words::is_identifier;
use fmu_description::xml::Element;
use fmu_description::{
    Causality, FmiVersion, Initial, ModelDescription, Type, Unknown, Value, Variability,
    XmlVariable,
};
use fmu_file::text::quote;
use regex_lite::Regex;

use crate::finding::{Findings, Location, find, require};
use crate::package::{INTERFACES, interfaces};
use crate::rule::{Rule, rule};
use crate::schema::anchored;

/// A model description that is checked.
struct Check<'a> {
    model: &'a ModelDescription<'a>,
    /// The indices of the states: of the variables that others are the derivatives of.
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
fn state_of(variable: &XmlVariable<'_>, model: &ModelDescription<'_>) -> Option<usize> {
    model.index(whole(variable.value.attribute("derivative")?)?)
}

pub fn is_clocked(variable: &XmlVariable<'_>) -> bool {
    variable.element.has("clocks")
}

pub fn is_continuous(variable: &XmlVariable<'_>) -> bool {
    variable.variability == Variability::Continuous
}

/// Whether it has a start value, which may be an empty text.
fn has_start(variable: &XmlVariable<'_>) -> bool {
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

    /// What refers to a variable, for messages.
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

/// The display units of each unit, by unit name.
type Units<'a> = HashMap<&'a str, HashSet<&'a str>>;
/// The item values of each enumeration type, by type name.
type Items<'a> = HashMap<&'a str, HashSet<i64>>;

/// Units and types, and what uses them: bounds, start values and display units.
impl<'a> Check<'a> {
    fn units(&mut self) {
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

    fn types(&mut self) {
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
    fn bounds(
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
    fn declared_type(&mut self, variable: &XmlVariable<'_>, items: &Items<'_>) {
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

/// The form of names by the naming convention `structured`: parts with indices, separated by periods, or the derivative
/// of such a name, of any order.
static STRUCTURED: LazyLock<Regex> = LazyLock::new(|| {
    let identifier = r#"(?:[A-Za-z_][A-Za-z0-9_]*|'(?:[ -&(-\[\]-~]|\\['"?\\abfnrtv])+')"#;
    let part = format!(r"{identifier}(?:\[[0-9]+(?:,[0-9]+)*\])?");
    let name = format!(r"{part}(?:\.{part})*");
    anchored(&format!(r"{name}|der\({name}(?:,[0-9]+)?\)"))
});

/// The values of `initial` allowed for a causality and a variability; `None` if that combination is
/// not allowed.
fn allowed(variable: &XmlVariable<'_>, version: FmiVersion) -> Option<&'static [Option<Initial>]> {
    use Causality::{
        CalculatedParameter, Independent, Input, Local, Output, Parameter, StructuralParameter,
    };
    use Initial::{Approx, Calculated, Exact};
    use Variability::{Constant, Continuous, Discrete, Fixed, Tunable};

    match (variable.causality, variable.variability) {
        (Input, Discrete | Continuous) if version == FmiVersion::Fmi3 => Some(&[Some(Exact)]),
        (Parameter | StructuralParameter, Fixed | Tunable) | (Output | Local, Constant) => {
            Some(&[Some(Exact)])
        }
        (CalculatedParameter | Local, Fixed | Tunable) => Some(&[Some(Calculated), Some(Approx)]),
        (Output | Local, Discrete | Continuous) => {
            Some(&[Some(Calculated), Some(Exact), Some(Approx)])
        }
        (Input, Discrete | Continuous) | (Independent, Continuous) => Some(&[None]),
        _ => None,
    }
}

/// Variables: their names, causality, variability, start values and value references.
impl Check<'_> {
    fn names(&mut self) {
        let convention = self.model.root.attribute("variableNamingConvention");
        let structured = convention == Some("structured");
        let mut names = HashSet::new();
        for (_, variable) in self.model.variables() {
            let own = [variable.name.as_str()].into_iter();
            for name in own.chain(variable.aliases()) {
                require!(self, "variable-unique" at variable, names.insert(name),
                    "two variables have the name {}, expected each once", quote(name));
                let is_given = !name.trim().is_empty();
                require!(self, "variable-named" at variable, is_given,
                    "the name is empty, expected a string");
                if structured && is_given {
                    let is_structured = STRUCTURED.is_match(name);
                    require!(self, "structured-names" at variable, is_structured,
                        "the name is not structured, expected a form such as a.b[1,2].c or der(a.b)");
                    let is_derivative = is_structured && name.starts_with("der(");
                    require!(self, "derivative-names" at variable,
                        !is_derivative || variable.of_type.is_float(),
                        "its name is reserved for a derivative, expected a {}, not {}",
                        self.float(), variable.value.name);
                }
                require!(self, "flat-names" at variable,
                    structured || !name.contains(['\r', '\n', '\t']),
                    "the name has a line break or tab, expected none");
            }
        }
    }

    fn variables(&mut self) {
        let model = self.model;
        for (variable, reason) in model.unimportable() {
            find!(self, "modelica-names" at variable, "{reason}, expected another name");
        }
        for (index, variable) in model.variables() {
            self.combination(variable);
            if variable.of_type != Type::Clock {
                let is_given = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
                let needs = is_given || variable.causality == Causality::Input;
                let has = has_start(variable);
                require!(self, "start-given" at variable, has || !needs,
                    "it has no start, expected one for an input, a constant, and initial exact or approx");
                require!(self, "no-start" at variable, needs || !has,
                    "it has a start, expected none for initial calculated and the independent variable");
            }
            if let Some(number) = variable.value.attribute("derivative").and_then(whole) {
                match model.variable(model.index(number)) {
                    None => find!(self, "derivative-index" at variable,
                        "derivative is {number}, expected {}", self.reference()),
                    Some(state) => require!(self, "derivative-of-state" at variable,
                        state.of_type.is_float() && is_continuous(state),
                        "it is the derivative of {:?}, expected a continuous {}", state.name, self.float()),
                }
            }
            self.restricted(variable, self.states.contains(&index));
        }
        self.independent();
        match model.version {
            FmiVersion::Fmi2 => self.aliases(),
            FmiVersion::Fmi3 => self.references(),
        }
    }

    fn combination(&mut self, variable: &XmlVariable<'_>) {
        let causality = variable.causality.as_str();
        let variability = variable.variability.as_str();
        match allowed(variable, self.model.version) {
            None => find!(self, "causality-variability" at variable,
                "causality {causality} and variability {variability} are combined, expected a \
                 combination that the standard allows"),
            Some(initials) => require!(self, "initial" at variable,
                variable.of_type == Type::Clock || initials.contains(&variable.initial),
                "initial is {}, expected one that goes with causality {causality} and variability \
                 {variability}", variable.element.attribute("initial").unwrap_or("missing")),
        }
        require!(self, "continuous-real" at variable,
            variable.of_type.is_float() || !is_continuous(variable),
            "variability is continuous (or missing), expected another for the type {}",
            variable.value.name);
    }

    /// Checks attributes that are for inputs or states only; in FMI 2.0, they are for model exchange only.
    fn restricted(&mut self, variable: &XmlVariable<'_>, is_state: bool) {
        const SET: &str = "canHandleMultipleSetPerTimeInstant";
        let (is_exchanged, also) = match self.model.version {
            FmiVersion::Fmi2 => (self.model.model_exchange().is_some(), " and model exchange"),
            FmiVersion::Fmi3 => (true, ""),
        };
        let is_input = variable.causality == Causality::Input;
        require!(self, "multiple-set" at variable,
            !variable.element.has(SET) || is_exchanged && is_input,
            "it has {SET}, expected it only for inputs{also}");
        require!(self, "reinit" at variable,
            !variable.value.has("reinit") || is_exchanged && is_state,
            "it has reinit, expected it only for states{also}");
    }

    fn independent(&mut self) {
        let mut first: Option<&str> = None;
        let variables = self.model.variables();
        for (_, variable) in variables.filter(|(_, v)| v.causality == Causality::Independent) {
            require!(self, "independent-real" at variable, variable.of_type.is_float(),
                "the independent variable is not a {0}, expected a {0}", self.float());
            if let Some(first) = first.replace(&variable.name) {
                find!(self, "independent-once" at variable,
                    "{first:?} is already the independent variable, expected at most one");
            }
        }
        require!(self, "independent-once" at self.model.root, first.is_some() || !self.is_3(),
            "there is no independent variable, expected exactly one");
    }

    /// Checks that value references are unique, as in FMI 3.0.
    fn references(&mut self) {
        let mut names = HashMap::new();
        for (_, variable) in self.model.variables() {
            let reference = variable.reference;
            let first = names.entry(reference).or_insert(&variable.name);
            require!(self, "reference-unique" at variable, **first == variable.name,
                "{first:?} has the value reference {reference}, too, expected each once");
        }
    }

    /// Checks variables of the same type and value reference, which share one value in FMI 2.0.
    fn aliases(&mut self) {
        let model = self.model;
        let mut sets: HashMap<(Type, u32), Vec<&XmlVariable<'_>>> = HashMap::new();
        for (_, variable) in model.variables() {
            let of_type = variable.of_type.accessed_as(model.version);
            let set = sets.entry((of_type, variable.reference));
            set.or_default().push(variable);
        }
        let mut sets: Vec<_> = sets.into_values().filter(|set| set.len() > 1).collect();
        sets.sort_by_key(|set| set[0].element.line);
        for set in sets {
            self.alias_set(&set);
        }
    }

    fn alias_set(&mut self, set: &[&XmlVariable<'_>]) {
        use Causality::{Independent, Input, Parameter};
        let first = set[0];
        let mut report = |rule: &'static Rule,
                          of: &XmlVariable<'_>,
                          variable: Option<&&XmlVariable<'_>>,
                          what: &str| {
            if let Some(variable) = variable {
                let text = format!("it has the value reference of {:?} {what}", of.name);
                self.add(rule, *variable, text);
            }
        };
        let is_settable =
            |v: &&&XmlVariable<'_>| matches!(v.causality, Parameter | Input | Independent);
        let what = "though both are set from outside, expected at most one such variable";
        report(rule!("alias-settable"), first, set.iter().filter(is_settable).nth(1), what);
        let is_constant = |v: &&&XmlVariable<'_>| v.variability == Variability::Constant;
        if let Some(constant) = set.iter().find(is_constant) {
            // An Integer may be an alias of an Enumeration.
            let start = |v: &XmlVariable<'_>| v.start_of(0).map(Value::to_string);
            let differs = |v: &&&XmlVariable<'_>| !is_constant(v) || start(v) != start(constant);
            let what = "which is constant, expected all to be constant with the same start";
            report(rule!("alias-constant"), constant, set.iter().find(differs), what);
        } else {
            let what = "and both have a start, expected at most one start";
            let mut started = set.iter().filter(|v| has_start(v));
            report(rule!("alias-start"), first, started.nth(1), what);
            let expected = first.variability;
            let other = set.iter().find(|v| v.variability != expected);
            let own = other.unwrap_or(&first).variability;
            let [own, expected] = [own, expected].map(Variability::as_str);
            let what = format!("and is {own}, expected {expected} like that variable");
            report(rule!("alias-variability"), first, other, &what);
        }
        let other = set.iter().find(|v| v.unit != first.unit);
        let what = "and another unit, expected the same unit";
        report(rule!("alias-unit"), first, other, what);
    }
}

/// The model structure (FMI 2.0.5, section 2.2.8; FMI 3.0.2, section 2.4.8).
impl Check<'_> {
    fn structure(&mut self) {
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

fn indices(unknowns: &[Unknown<'_>]) -> HashSet<usize> {
    unknowns.iter().filter_map(|u| u.index).collect()
}

/// What FMI 3.0 adds: arrays, structural parameters, clocks and clocked variables.
impl Check<'_> {
    /// Checks the number of bytes of the start values of a Binary.
    fn start_size(&mut self, variable: &XmlVariable<'_>) {
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
    fn elements(&mut self, variable: &XmlVariable<'_>) {
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

    fn clocks(&mut self) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structured_names_have_the_form_of_the_standard() {
        let good = r"a|_a1|a.b.c|rbf.w[1]|a[1,2].b[3]|der(a)|der(a.b[1])|der(a[1,2])|der(a,2)|'a b'.c|'it\'s'|a.'[x]'[2]|der('a,b')";
        for good in good.split('|') {
            assert!(STRUCTURED.is_match(good), "{good}");
        }
        let bad = r"|1a|a.|.a|a..b|a[|a[]|a[x]|a[1|a b|a-b|ä|der(|der()|der(a|a)|''|'a|'a\x'|a[1,]|der(a,)|a[1]b";
        for bad in bad.split('|') {
            assert!(!STRUCTURED.is_match(bad), "{bad}");
        }
    }
}
