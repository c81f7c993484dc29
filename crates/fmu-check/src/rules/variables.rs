//! Rules for variables: their names, causality, variability, start values and value references (FMI
//! 2.0.5, sections 2.2.7 and 2.2.9; FMI 3.0.2, section 2.4.7).

use std::collections::{HashMap, HashSet};

use fmu_description::value::unsigned;
use fmu_description::{
    Causality, FmiVersion, Initial, Listed, ModelDescription, Type, Variability,
};
use fmu_file::text::quote;

use super::definitions::{expected, float};
use crate::finding::{Findings, find, require};
use crate::rule::{Rule, rules};

rules! {
    /// Names of variables.
    pub NAMES {
        UNIQUE_VARIABLE_NAMES: Error, "variable-unique", Standard("section 2.2.7", "section 2.4.7.4"),
            "The names of variables, and of their aliases in FMI 3.0, are unique.";
        VARIABLE_NAME_GIVEN: Error, "variable-named", Standard("section 2.2.7", "section 2.4.7.4"),
            "A variable has a name.";
        STRUCTURED_NAMES: Error, "structured-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Names follow the grammar of the naming convention structured, if the FMU declares it.";
        FLAT_NAMES: Error, "flat-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Names have no line breaks and tabs.";
        DERIVATIVE_NAMES: Error, "derivative-names", Standard("section 2.2.9", "section 2.4.7.5.1"),
            "Structured names der(...) are those of Reals, in FMI 3.0 Float32 or Float64.";
    }

    /// Variables, and those that share a value reference.
    pub VARIABLES {
        INDEPENDENT_REAL: Error, "independent-real", Standard("section 2.2.7", "section 2.4.7.4"),
            "The independent variable is a Real, in FMI 3.0 Float32 or Float64.";
        INDEPENDENT_ONCE: Error, "independent-once", Standard("section 2.2.7", "section 2.4.7.4"),
            "There is at most one independent variable, in FMI 3.0 exactly one.";
        COMBINATION: Error, "causality-variability", Standard("section 2.2.7", "section 2.4.7.4"),
            "Causality and variability are combined as the table of the standard allows.";
        INITIAL: Error, "initial", Standard("section 2.2.7", "section 2.4.7.5"),
            "initial is one that the table of the standard allows for causality and variability.";
        CONTINUOUS_REAL: Error, "continuous-real", Standard("section 2.2.7", "section 2.4.7.4"),
            "Only Reals, in FMI 3.0 Float32 and Float64, are continuous.";
        START_GIVEN: Error, "start-given", Standard("section 2.2.7", "section 2.4.7.5"),
            "Inputs, constants, and variables with initial exact or approx have a start value.";
        NO_START: Error, "no-start", Standard("section 2.2.7", "section 2.4.7.5"),
            "Variables with initial calculated and the independent variable have no start value.";
        DERIVATIVE_OF_STATE: Error, "derivative-of-state", Standard("section 2.2.7", "section 2.4.7.5"),
            "derivative names a continuous Real, in FMI 3.0 Float32 or Float64.";
        DERIVATIVE_INDEX: Error, "derivative-index", Standard("section 2.2.7", "section 2.4.7.5"),
            "derivative is the index, in FMI 3.0 the value reference, of a variable.";
        MULTIPLE_SET: Error, "multiple-set", Standard("section 2.2.7", "section 2.4.7.4"),
            "canHandleMultipleSetPerTimeInstant is given only for inputs, in FMI 2.0 of an FMU for model exchange.";
        REINIT: Error, "reinit", Standard("section 2.2.7", "section 2.4.7.5"),
            "reinit is given only for states, in FMI 2.0 of an FMU for model exchange.";
        REFERENCE_UNIQUE: Error, "reference-unique", Fmi3("section 2.4.7.4"),
            "The value references of variables are unique.";
        ALIAS_SETTABLE: Error, "alias-settable", Fmi2("section 2.2.7"),
            "At most one of the variables with the same value reference is set from outside.";
        ALIAS_CONSTANT: Error, "alias-constant", Fmi2("section 2.2.7"),
            "Variables with the value reference of a constant are constants with the same start value.";
        ALIAS_START: Error, "alias-start", Fmi2("section 2.2.7"),
            "At most one of the variables with the same value reference has a start value.";
        ALIAS_UNIT: Error, "alias-unit", Fmi2("section 2.2.7"),
            "Variables with the same value reference have the same unit.";
        ALIAS_VARIABILITY: Warning, "alias-variability", Fmi2("section 2.2.7"),
            "Variables with the same value reference have the same variability.";
    }
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    names(model, findings);
    let states: HashSet<usize> = (model.variables())
        .filter_map(|(_, v)| model.index(unsigned(v.value.attribute("derivative")?)?))
        .collect();
    for (index, variable) in model.variables() {
        combination(variable, model, findings);
        start(variable, findings);
        derivative(variable, model, findings);
        restricted(variable, states.contains(&index), model, findings);
    }
    independent(model, findings);
    match model.version {
        FmiVersion::Fmi2 => aliases(model, findings),
        FmiVersion::Fmi3 => references(model, findings),
    }
}

fn names(model: &ModelDescription<'_>, findings: &mut Findings) {
    let structured = model.root.attribute("variableNamingConvention") == Some("structured");
    let mut names = HashSet::new();
    for (_, variable) in model.variables() {
        for name in [variable.name.as_str()]
            .into_iter()
            .chain(variable.aliases())
        {
            require!(findings, UNIQUE_VARIABLE_NAMES at variable, names.insert(name),
                "two variables have the name {}, expected each once", quote(name));
            let is_given = !name.trim().is_empty();
            require!(findings, VARIABLE_NAME_GIVEN at variable, is_given,
                "the name is empty, expected a string");
            if structured && is_given {
                let is_structured = is_structured(name);
                require!(findings, STRUCTURED_NAMES at variable, is_structured,
                    "the name is not structured, expected a form such as a.b[1,2].c or der(a.b)");
                let is_derivative = is_structured && name.starts_with("der(");
                require!(findings, DERIVATIVE_NAMES at variable,
                    !is_derivative || variable.of_type.is_float(),
                    "the name is that of a derivative, expected a {}, not {}",
                    float(model), variable.value.name);
            }
            require!(findings, FLAT_NAMES at variable,
                structured || !name.contains(['\r', '\n', '\t']),
                "the name has a line break or tab, expected none");
        }
    }
}

/// Whether a name has the form of the naming convention `structured`.
fn is_structured(name: &str) -> bool {
    let whole = |text: &str| identifier(text).is_some_and(str::is_empty);
    match name
        .strip_prefix("der(")
        .and_then(|rest| rest.strip_suffix(')'))
    {
        None => whole(name),
        Some(inner) => match inner.rsplit_once(',') {
            // The comma may also separate indices.
            Some((inner, order)) if is_number(order) => whole(inner),
            _ => whole(inner),
        },
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// The rest of a text after its leading identifier: names with indices, separated by dots.
fn identifier(mut text: &str) -> Option<&str> {
    loop {
        text = match text.strip_prefix('\'') {
            Some(rest) => quoted(rest)?,
            None => plain(text)?,
        };
        if let Some(rest) = text.strip_prefix('[') {
            let (indices, rest) = rest.split_once(']')?;
            if !indices.split(',').all(is_number) {
                return None;
            }
            text = rest;
        }
        match text.strip_prefix('.') {
            Some(rest) => text = rest,
            None => return Some(text),
        }
    }
}

/// The rest of a text after a name of letters, digits and underscores.
fn plain(text: &str) -> Option<&str> {
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let rest = text.trim_start_matches(is_name);
    let starts_well = text.starts_with(|c: char| is_name(c) && !c.is_ascii_digit());
    starts_well.then_some(rest)
}

/// The rest of a text after a quoted name, whose opening quote has been read.
fn quoted(text: &str) -> Option<&str> {
    let mut characters = text.char_indices();
    while let Some((at, character)) = characters.next() {
        match character {
            '\'' => return (at > 0).then(|| &text[at + 1..]),
            '\\' => {
                let (_, escaped) = characters.next()?;
                if !"'\"?\\abfnrtv".contains(escaped) {
                    return None;
                }
            }
            ' '..='~' => {}
            _ => return None,
        }
    }
    None
}

/// The values of `initial` allowed for a causality and a variability; `None` if that combination is
/// not allowed.
fn allowed(
    version: FmiVersion,
    causality: Causality,
    variability: Variability,
) -> Option<&'static [Option<Initial>]> {
    use Causality::{
        CalculatedParameter, Independent, Input, Local, Output, Parameter, StructuralParameter,
    };
    use Variability::{Constant, Continuous, Discrete, Fixed, Tunable};

    const EXACT: &[Option<Initial>] = &[Some(Initial::Exact)];
    const COMPUTED: &[Option<Initial>] = &[Some(Initial::Calculated), Some(Initial::Approx)];
    const ANY: &[Option<Initial>] = &[
        Some(Initial::Calculated),
        Some(Initial::Exact),
        Some(Initial::Approx),
    ];
    const NONE: &[Option<Initial>] = &[None];
    match (causality, variability) {
        (Input, Discrete | Continuous) if version == FmiVersion::Fmi3 => Some(EXACT),
        (Parameter | StructuralParameter, Fixed | Tunable) | (Output | Local, Constant) => {
            Some(EXACT)
        }
        (CalculatedParameter | Local, Fixed | Tunable) => Some(COMPUTED),
        (Output | Local, Discrete | Continuous) => Some(ANY),
        (Input, Discrete | Continuous) | (Independent, Continuous) => Some(NONE),
        _ => None,
    }
}

fn combination(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let causality = variable.causality.as_str();
    let variability = variable.variability.as_str();
    match allowed(model.version, variable.causality, variable.variability) {
        None => find!(findings, COMBINATION at variable,
            "causality {causality} and variability {variability} are combined, expected a \
             combination that the standard allows"),
        Some(initials) => require!(findings, INITIAL at variable,
            variable.of_type == Type::Clock || initials.contains(&variable.initial),
            "initial is {}, expected one that goes with causality {causality} and variability \
             {variability}", variable.element.attribute("initial").unwrap_or("missing")),
    }
    let is_continuous = variable.variability == Variability::Continuous;
    require!(findings, CONTINUOUS_REAL at variable, variable.of_type.is_float() || !is_continuous,
        "variability is continuous (or missing), expected another for the type {}",
        variable.value.name);
}

/// Whether it has a start value, which may be an empty text.
fn has_start(variable: &Listed<'_>) -> bool {
    variable.start().is_some() || variable.value.child("Start").is_some()
}

fn start(variable: &Listed<'_>, findings: &mut Findings) {
    if variable.of_type != Type::Clock {
        let is_given = matches!(variable.initial, Some(Initial::Exact | Initial::Approx));
        let needs = is_given || variable.causality == Causality::Input;
        let has = has_start(variable);
        require!(findings, START_GIVEN at variable, has || !needs,
            "it has no start, expected one for an input, a constant, and initial exact or approx");
        require!(findings, NO_START at variable, needs || !has,
            "it has a start, expected none for initial calculated and the independent variable");
    }
}

fn derivative(variable: &Listed<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let Some(number) = variable.value.attribute("derivative").and_then(unsigned) else {
        return;
    };
    match model.variable(model.index(number)) {
        None => find!(findings, DERIVATIVE_INDEX at variable,
            "derivative is {number}, expected {}", expected(model)),
        Some(state) => require!(findings, DERIVATIVE_OF_STATE at variable,
            state.of_type.is_float() && state.variability == Variability::Continuous,
            "it is the derivative of {:?}, expected a continuous {}", state.name, float(model)),
    }
}

/// Checks attributes that are for inputs or states only; in FMI 2.0, they are for model exchange only.
fn restricted(
    variable: &Listed<'_>,
    is_state: bool,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    const SET: &str = "canHandleMultipleSetPerTimeInstant";
    let (is_exchanged, also) = match model.version {
        FmiVersion::Fmi2 => (model.model_exchange().is_some(), " and model exchange"),
        FmiVersion::Fmi3 => (true, ""),
    };
    let is_input = variable.causality == Causality::Input;
    require!(findings, MULTIPLE_SET at variable,
        !variable.element.has(SET) || is_exchanged && is_input,
        "it has {SET}, expected it only for inputs{also}");
    require!(findings, REINIT at variable,
        !variable.value.has("reinit") || is_exchanged && is_state,
        "it has reinit, expected it only for states{also}");
}

fn independent(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut first: Option<&str> = None;
    let is_independent = |v: &&Listed<'_>| v.causality == Causality::Independent;
    for variable in model.variables().map(|(_, v)| v).filter(is_independent) {
        require!(findings, INDEPENDENT_REAL at variable, variable.of_type.is_float(),
            "the independent variable is not a {0}, expected a {0}", float(model));
        if let Some(first) = first.replace(&variable.name) {
            find!(findings, INDEPENDENT_ONCE at variable,
                "it is independent like {first:?} is, expected at most one independent variable");
        }
    }
    let needs_one = model.version == FmiVersion::Fmi3;
    require!(findings, INDEPENDENT_ONCE at model.root, first.is_some() || !needs_one,
        "there is no independent variable, expected exactly one");
}

/// Checks that value references are unique, as in FMI 3.0.
fn references(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut names = HashMap::new();
    for (_, variable) in model.variables() {
        let reference = variable.reference;
        let first = names.entry(reference).or_insert(&variable.name);
        require!(findings, REFERENCE_UNIQUE at variable, **first == variable.name,
            "{first:?} has the value reference {reference}, too, expected each once");
    }
}

/// Checks variables of the same type and value reference, which share one value.
fn aliases(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut sets: HashMap<(Type, u32), Vec<&Listed<'_>>> = HashMap::new();
    for (_, variable) in model.variables() {
        let of_type = variable.of_type.accessed_as(model.version);
        let set = sets.entry((of_type, variable.reference));
        set.or_default().push(variable);
    }
    let mut sets: Vec<_> = sets.into_values().filter(|set| set.len() > 1).collect();
    sets.sort_by_key(|set| set[0].element.line);
    for set in sets {
        alias_set(&set, findings);
    }
}

fn alias_set(set: &[&Listed<'_>], findings: &mut Findings) {
    use Causality::{Independent, Input, Parameter};
    let first = set[0];
    let is_constant = |v: &Listed<'_>| v.variability == Variability::Constant;
    let is_settable = |v: &&&Listed<'_>| matches!(v.causality, Parameter | Input | Independent);
    let mut report = |rule: &'static Rule, variable: Option<&&Listed<'_>>, what: &str| {
        if let Some(variable) = variable {
            let text = format!("it has the value reference of {:?} {what}", first.name);
            findings.add(rule, *variable, text);
        }
    };
    let what = "though both are set from outside, expected at most one such variable";
    report(&ALIAS_SETTABLE, set.iter().filter(is_settable).nth(1), what);
    let has_constant = set.iter().any(|v| is_constant(v));
    if has_constant {
        let differs = |v: &&&Listed<'_>| v.start() != first.start() || !is_constant(v);
        let what = "which is constant, expected all to be constant with the same start";
        report(&ALIAS_CONSTANT, set.iter().find(differs), what);
    } else {
        let what = "and both have a start, expected at most one start";
        let mut started = set.iter().filter(|v| has_start(v));
        report(&ALIAS_START, started.nth(1), what);
        let expected = first.variability;
        let other = set.iter().find(|v| v.variability != expected);
        let (own, expected) = (
            other.unwrap_or(&first).variability.as_str(),
            expected.as_str(),
        );
        let what = format!("and is {own}, expected {expected} like that variable");
        report(&ALIAS_VARIABILITY, other, &what);
    }
    let other = set.iter().find(|v| v.unit != first.unit);
    report(
        &ALIAS_UNIT,
        other,
        "and another unit, expected the same unit",
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn structured_names_have_the_form_of_the_standard() {
        for good in [
            "a",
            "_a1",
            "a.b.c",
            "rbf.w[1]",
            "a[1,2].b[3]",
            "der(a)",
            "der(a.b[1])",
            "der(a[1,2])",
            "der(a,2)",
            "'a b'.c",
            "'it\\'s'",
            "a.'[x]'[2]",
            "der('a,b')",
        ] {
            assert!(is_structured(good), "{good}");
        }
        for bad in [
            "", "1a", "a.", ".a", "a..b", "a[", "a[]", "a[x]", "a[1", "a b", "a-b", "ä", "der(",
            "der()", "der(a", "a)", "''", "'a", "'a\\x'", "a[1,]", "der(a,)", "a[1]b",
        ] {
            assert!(!is_structured(bad), "{bad}");
        }
    }
}
