//! Rules for variables, and for variables with the same value reference (FMI 2.0.5, section 2.2.7; FMI
//! 3.0.2, section 2.4.7).

use std::collections::{HashMap, HashSet};

use fmu_description::value::unsigned;

use fmu_description::{Causality, FmiVersion, Initial, Variability};

use super::{Kind, Model, Variable};
use crate::finding::Findings;
use crate::rule::rules;

rules! {
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

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    let mut independent = None;
    let states: HashSet<usize> = (model.variables())
        .filter_map(|(_, v)| model.index(unsigned(v.value.attribute("derivative")?)?))
        .collect();
    for (index, variable) in model.variables() {
        combination(variable, model, findings);
        start(variable, findings);
        derivative(variable, model, findings);
        restricted(index, variable, &states, model, findings);
        if variable.causality == Causality::Independent {
            if variable.kind != Kind::Float {
                findings.add(
                    &INDEPENDENT_REAL,
                    variable,
                    format!(
                        "the independent variable is not a {0}, expected a {0}",
                        model.float()
                    ),
                );
            }
            if let Some(first) = independent.replace(variable.name) {
                findings.add(&INDEPENDENT_ONCE, variable,
                    format!("it is independent like {first:?} is, expected at most one independent variable"),
                );
            }
        }
    }
    match model.version {
        FmiVersion::Fmi2 => aliases(model, findings),
        FmiVersion::Fmi3 => {
            if independent.is_none() {
                let text = "there is no independent variable, expected exactly one";
                findings.add(&INDEPENDENT_ONCE, model.root, text);
            }
            references(model, findings);
        }
    }
}

/// The values of `initial` allowed for a causality and a variability; `None` if that combination is
/// not allowed.
fn allowed(
    version: FmiVersion,
    causality: Causality,
    variability: Variability,
) -> Option<&'static [Option<Initial>]> {
    use Causality::{CalculatedParameter, Independent, Input, Local, Output, Parameter};
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
        (Parameter, Fixed | Tunable) | (Output | Local, Constant) => Some(EXACT),
        (CalculatedParameter | Local, Fixed | Tunable) => Some(COMPUTED),
        (Output | Local, Discrete | Continuous) => Some(ANY),
        (Input, Discrete | Continuous) | (Independent, Continuous) => Some(NONE),
        _ => None,
    }
}

fn combination(variable: &Variable<'_>, model: &Model<'_>, findings: &mut Findings) {
    let written = |name, default| variable.element.attribute(name).unwrap_or(default);
    let causality = written("causality", "local");
    let variability = variable.variability.as_str();
    match allowed(model.version, variable.causality, variable.variability) {
        None => findings.add(&COMBINATION, variable,
            format!(
                "causality {causality} and variability {variability} are combined, expected a combination that the standard allows"
            ),
        ),
        Some(initials) if variable.kind != Kind::Clock && !initials.contains(&variable.initial) => findings.add(&INITIAL, variable,
            format!(
                "initial is {}, expected one that goes with causality {causality} and variability {variability}",
                written("initial", "missing")
            ),
        ),
        Some(_) => {}
    }
    if variable.kind != Kind::Float && variable.variability == Variability::Continuous {
        findings.add(
            &CONTINUOUS_REAL,
            variable,
            format!(
                "variability is continuous (or missing), expected another for the type {}",
                variable.value.name
            ),
        );
    }
}

fn start(variable: &Variable<'_>, findings: &mut Findings) {
    if variable.kind == Kind::Clock {
        return;
    }
    let needs = matches!(variable.initial, Some(Initial::Exact | Initial::Approx))
        || variable.causality == Causality::Input;
    match variable.start() {
        None if needs => findings.add(
            &START_GIVEN,
            variable,
            "it has no start, expected one for an input, a constant, and initial exact or approx",
        ),
        Some(_) if !needs => findings.add(
            &NO_START,
            variable,
            "it has a start, expected none for initial calculated and the independent variable",
        ),
        _ => {}
    }
}

fn derivative(variable: &Variable<'_>, model: &Model<'_>, findings: &mut Findings) {
    let Some(number) = variable.value.attribute("derivative").and_then(unsigned) else {
        return;
    };
    match model.variable(model.index(number)) {
        Some(state)
            if state.kind == Kind::Float && state.variability == Variability::Continuous => {}
        Some(state) => findings.add(
            &DERIVATIVE_OF_STATE,
            variable,
            format!(
                "it is the derivative of {:?}, expected a continuous {}",
                state.name,
                model.float()
            ),
        ),
        None => findings.add(
            &DERIVATIVE_INDEX,
            variable,
            format!("derivative is {number}, expected {}", model.expected()),
        ),
    }
}

/// Checks attributes that are for inputs or states only; `states` has the indices of the states. In FMI
/// 2.0, they are for model exchange only.
fn restricted(
    index: usize,
    variable: &Variable<'_>,
    states: &HashSet<usize>,
    model: &Model<'_>,
    findings: &mut Findings,
) {
    const SET: &str = "canHandleMultipleSetPerTimeInstant";
    let is_exchanged =
        model.version == FmiVersion::Fmi3 || model.root.child("ModelExchange").is_some();
    let also = match model.version {
        FmiVersion::Fmi2 => " and model exchange",
        FmiVersion::Fmi3 => "",
    };
    let is_input = variable.causality == Causality::Input;
    if variable.element.attribute(SET).is_some() && !(is_exchanged && is_input) {
        let text = format!("it has {SET}, expected it only for inputs{also}");
        findings.add(&MULTIPLE_SET, variable, text);
    }
    if variable.value.attribute("reinit").is_some() && !(is_exchanged && states.contains(&index)) {
        let text = format!("it has reinit, expected it only for states{also}");
        findings.add(&REINIT, variable, text);
    }
}

/// Checks that value references are unique, as in FMI 3.0.
fn references(model: &Model<'_>, findings: &mut Findings) {
    let mut names = HashMap::new();
    for (_, variable) in model.variables() {
        let first = names.entry(variable.reference).or_insert(variable.name);
        if *first != variable.name {
            let reference = variable.reference;
            let text =
                format!("{first:?} has the value reference {reference}, too, expected each once");
            findings.add(&REFERENCE_UNIQUE, variable, text);
        }
    }
}

/// Checks variables of the same type and value reference, which share one value.
fn aliases(model: &Model<'_>, findings: &mut Findings) {
    let mut sets: HashMap<(Kind, u32), Vec<&Variable<'_>>> = HashMap::new();
    for (_, variable) in model.variables() {
        // An Enumeration is accessed as an Integer (FMI 2.0.5, section 2.1.7).
        let kind = match variable.kind {
            Kind::Enumeration => Kind::Integer,
            kind => kind,
        };
        let key = (kind, variable.reference);
        let set = sets.entry(key).or_default();
        set.push(variable);
    }
    let mut sets: Vec<_> = sets.into_values().filter(|set| set.len() > 1).collect();
    sets.sort_by_key(|set| set[0].element.line);
    for set in sets {
        alias_set(&set, findings);
    }
}

fn alias_set(set: &[&Variable<'_>], findings: &mut Findings) {
    let constant = |v: &&&Variable<'_>| v.variability == Variability::Constant;
    let settable = |v: &&&Variable<'_>| {
        matches!(
            v.causality,
            Causality::Parameter | Causality::Input | Causality::Independent
        )
    };
    let started = |v: &&&Variable<'_>| v.start().is_some();
    let mut report = |rule, variable: &Variable<'_>, what: &str| {
        findings.add(
            rule,
            variable,
            format!("it has the value reference of {:?} {what}", set[0].name),
        );
    };
    if let Some(second) = set.iter().filter(settable).nth(1) {
        report(
            &ALIAS_SETTABLE,
            second,
            "though both are set from outside, expected at most one such variable",
        );
    }
    let constants = set.iter().filter(constant).count();
    if constants != 0 {
        let other = set
            .iter()
            .find(|v| v.start() != set[0].start() || !constant(v));
        if let Some(other) = other {
            report(
                &ALIAS_CONSTANT,
                other,
                "which is constant, expected all to be constant with the same start",
            );
        }
    } else if let Some(second) = set.iter().filter(started).nth(1) {
        report(
            &ALIAS_START,
            second,
            "and both have a start, expected at most one start",
        );
    }
    if let Some(other) = set.iter().find(|v| v.unit() != set[0].unit()) {
        report(
            &ALIAS_UNIT,
            other,
            "and another unit, expected the same unit",
        );
    }
    if constants == 0
        && let Some(other) = set.iter().find(|v| v.variability != set[0].variability)
    {
        let (own, first) = (other.variability.as_str(), set[0].variability.as_str());
        let what = format!("and is {own}, expected {first} like that variable");
        report(&ALIAS_VARIABILITY, other, &what);
    }
}
