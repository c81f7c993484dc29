//! Variables: names, causality, variability, start values and value references.

use std::collections::{HashMap, HashSet};
use std::sync::LazyLock;

use fmu_description::value::whole;
use fmu_description::{
    Causality, FmiVersion, Initial, Naming, Type, Value, Variability, XmlVariable,
};
use fmu_file::text::quote;
use regex_lite::Regex;

use super::{Check, has_start, is_continuous};
use crate::finding::{find, require};
use crate::rule::{Rule, rule};
use crate::schema::anchored;

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

impl Check<'_> {
    pub(super) fn names(&mut self) {
        let convention = self.model.root.attribute("variableNamingConvention");
        let structured = convention == Some("structured");
        let mut names = HashSet::new();
        for (_, variable) in self.model.variables() {
            for name in variable.names() {
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
        let tool = self.model.root.attribute("generationTool").unwrap_or_default();
        if structured && tool.starts_with("cargo-fmu ") {
            self.hint_at_buses();
        }
    }

    /// Simulink's FMU block makes a port with a bus of inputs with structured names. Only the exporter of this project
    /// is known to have the remedy.
    fn hint_at_buses(&mut self) {
        let variables = self.model.variables().map(|(_, variable)| variable);
        let inputs = variables.filter(|v| v.causality == Causality::Input);
        let structured = inputs.filter(|v| v.name.contains(['.', '[']));
        let names: Vec<&str> = structured.map(|v| &*v.name).collect();
        let Some((first, others)) = names.split_first() else { return };
        let more =
            if others.is_empty() { String::new() } else { format!(" and {} more", others.len()) };
        let (name, flat) = (quote(first), quote(&Naming::Flat.write((*first).to_owned())));
        self.findings.add_hint(&format!(
            "Simulink makes a bus of structured names of inputs: {name}{more}; for a port each, export flat names such as {flat} (naming = \"flat\")"
        ));
    }

    pub(super) fn variables(&mut self) {
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

#[cfg(test)]
mod tests {
    use fmu_description::{ModelDescription, xml};

    use super::*;
    use crate::finding::Findings;
    use crate::rules::check;

    #[test]
    fn structured_names_of_inputs_are_hinted_at() {
        let hints_of = |tool: &str, convention: &str, names: &[&str]| {
            let inputs =
                names.iter().map(|name| format!("<Float64 name='{name}' causality='input'/>"));
            let xml = format!(
                "<fmiModelDescription fmiVersion='3.0' generationTool='{tool}' variableNamingConvention='{convention}'>
                <ModelVariables>{}<Float64 name='w.y' causality='output'/></ModelVariables></fmiModelDescription>",
                inputs.collect::<String>().replace("causality", "valueReference='1' causality")
            );
            let root = xml::parse(&xml).unwrap();
            let mut findings = Findings::default();
            check(&ModelDescription::new(&root), &mut findings);
            findings.hints().to_vec()
        };
        let hints = |convention, names| hints_of("cargo-fmu 0.1.0", convention, names);
        let found = hints("structured", &["r", "pid.y[1]", "a[1]"]).concat();
        assert!(found.contains("\"pid.y[1]\" and 1 more;"), "{found}");
        assert!(found.contains("flat names such as \"pid_y_1\""), "{found}");
        assert!(hints("structured", &["pid.y"]).concat().contains("inputs: \"pid.y\";"));
        assert!(hints("structured", &["r", "y"]).is_empty());
        assert!(hints("flat", &["pid.y"]).is_empty());
        assert!(hints_of("another tool", "structured", &["pid.y"]).is_empty());
    }

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
