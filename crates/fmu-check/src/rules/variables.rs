//! Rules for variables, and for variables with the same value reference (FMI 2.0.5, section 2.2.7).

use std::collections::{HashMap, HashSet};

use fmu_description::value::unsigned;
use fmu_description::{
    Causality, Initial, ModelDescription, ScalarVariable, Variability, VariableType,
};

use crate::finding::Findings;
use crate::rule::rules;

rules! {
    /// Variables, and those that share a value reference.
    pub VARIABLES {
        INDEPENDENT_REAL: Error, "independent-real", Standard("section 2.2.7"),
            "The independent variable is a Real.";
        INDEPENDENT_ONCE: Error, "independent-once", Standard("section 2.2.7"),
            "There is at most one independent variable.";
        COMBINATION: Error, "causality-variability", Standard("section 2.2.7"),
            "Causality and variability are combined as the table of the standard allows.";
        INITIAL: Error, "initial", Standard("section 2.2.7"),
            "initial is one that the table of the standard allows for causality and variability.";
        CONTINUOUS_REAL: Error, "continuous-real", Standard("section 2.2.7"),
            "Only Reals are continuous.";
        START_GIVEN: Error, "start-given", Standard("section 2.2.7"),
            "Inputs, constants, and variables with initial exact or approx have a start value.";
        NO_START: Error, "no-start", Standard("section 2.2.7"),
            "Variables with initial calculated and the independent variable have no start value.";
        DERIVATIVE_OF_STATE: Error, "derivative-of-state", Standard("section 2.2.7"),
            "derivative names a continuous Real.";
        DERIVATIVE_INDEX: Error, "derivative-index", Standard("section 2.2.7"),
            "derivative is the index of a variable.";
        MULTIPLE_SET: Error, "multiple-set", Standard("section 2.2.7"),
            "canHandleMultipleSetPerTimeInstant is given only for inputs of an FMU for model exchange.";
        REINIT: Error, "reinit", Standard("section 2.2.7"),
            "reinit is given only for states of an FMU for model exchange.";
        ALIAS_SETTABLE: Error, "alias-settable", Standard("section 2.2.7"),
            "At most one of the variables with the same value reference is set from outside.";
        ALIAS_CONSTANT: Error, "alias-constant", Standard("section 2.2.7"),
            "Variables with the value reference of a constant are constants with the same start value.";
        ALIAS_START: Error, "alias-start", Standard("section 2.2.7"),
            "At most one of the variables with the same value reference has a start value.";
        ALIAS_UNIT: Error, "alias-unit", Standard("section 2.2.7"),
            "Variables with the same value reference have the same unit.";
        ALIAS_VARIABILITY: Warning, "alias-variability", Standard("section 2.2.7"),
            "Variables with the same value reference have the same variability.";
    }
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut independent = None;
    let states: HashSet<u32> = (model.variables())
        .filter_map(|(_, v)| v.value.attribute("derivative").and_then(unsigned))
        .collect();
    for (index, variable) in model.variables() {
        combination(variable, findings);
        start(variable, findings);
        derivative(variable, model, findings);
        model_exchange_only(index, variable, &states, model, findings);
        if variable.causality == Causality::Independent {
            if variable.kind != VariableType::Real {
                findings.add(
                    &INDEPENDENT_REAL,
                    variable,
                    "the independent variable is not a Real, expected a Real",
                );
            }
            if let Some(first) = independent.replace(variable.name) {
                findings.add(&INDEPENDENT_ONCE, variable,
                    format!("it is independent like {first:?} is, expected at most one independent variable"),
                );
            }
        }
    }
    aliases(model, findings);
}

/// The values of `initial` allowed for a causality and a variability; `None` if that combination is
/// not allowed.
fn allowed(causality: Causality, variability: Variability) -> Option<&'static [Option<Initial>]> {
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
        (Parameter, Fixed | Tunable) | (Output | Local, Constant) => Some(EXACT),
        (CalculatedParameter | Local, Fixed | Tunable) => Some(COMPUTED),
        (Output | Local, Discrete | Continuous) => Some(ANY),
        (Input, Discrete | Continuous) | (Independent, Continuous) => Some(NONE),
        _ => None,
    }
}

fn combination(variable: &ScalarVariable<'_>, findings: &mut Findings) {
    let written = |name, default| variable.element.attribute(name).unwrap_or(default);
    let causality = written("causality", "local");
    let variability = written("variability", "continuous");
    match allowed(variable.causality, variable.variability) {
        None => findings.add(&COMBINATION, variable,
            format!(
                "causality {causality} and variability {variability} are combined, expected a combination that the standard allows"
            ),
        ),
        Some(initials) if !initials.contains(&variable.initial) => findings.add(&INITIAL, variable,
            format!(
                "initial is {}, expected one that goes with causality {causality} and variability {variability}",
                written("initial", "missing")
            ),
        ),
        Some(_) => {}
    }
    if variable.kind != VariableType::Real && variable.variability == Variability::Continuous {
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

fn start(variable: &ScalarVariable<'_>, findings: &mut Findings) {
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

fn derivative(
    variable: &ScalarVariable<'_>,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    let Some(index) = variable.value.attribute("derivative").and_then(unsigned) else {
        return;
    };
    match model.variable(index as usize) {
        Some(state)
            if state.kind == VariableType::Real && state.variability == Variability::Continuous => {
        }
        Some(state) => findings.add(
            &DERIVATIVE_OF_STATE,
            variable,
            format!(
                "it is the derivative of {:?}, expected a continuous Real",
                state.name
            ),
        ),
        None => findings.add(
            &DERIVATIVE_INDEX,
            variable,
            format!(
                "derivative is {index}, expected the index of a variable, 1 to {}",
                model.variables.len()
            ),
        ),
    }
}

/// Checks attributes that are for model exchange only; `states` has the indices of the states.
fn model_exchange_only(
    index: usize,
    variable: &ScalarVariable<'_>,
    states: &HashSet<u32>,
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    const SET: &str = "canHandleMultipleSetPerTimeInstant";
    let is_exchanged = model.root.child("ModelExchange").is_some();
    let is_input = variable.causality == Causality::Input;
    if variable.element.attribute(SET).is_some() && !(is_exchanged && is_input) {
        let text = format!("it has {SET}, expected it only for inputs and model exchange");
        findings.add(&MULTIPLE_SET, variable, text);
    }
    let is_state = u32::try_from(index).is_ok_and(|index| states.contains(&index));
    if variable.value.attribute("reinit").is_some() && !(is_exchanged && is_state) {
        let text = "it has reinit, expected it only for states and model exchange";
        findings.add(&REINIT, variable, text);
    }
}

/// Checks variables of the same type and value reference, which share one value.
fn aliases(model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut sets: HashMap<(VariableType, u32), Vec<&ScalarVariable<'_>>> = HashMap::new();
    for (_, variable) in model.variables() {
        let key = (variable.kind.accessed_as(), variable.reference);
        let set = sets.entry(key).or_default();
        set.push(variable);
    }
    let mut sets: Vec<_> = sets.into_values().filter(|set| set.len() > 1).collect();
    sets.sort_by_key(|set| set[0].element.line);
    for set in sets {
        alias_set(&set, findings);
    }
}

fn alias_set(set: &[&ScalarVariable<'_>], findings: &mut Findings) {
    let constant = |v: &&&ScalarVariable<'_>| v.variability == Variability::Constant;
    let settable = |v: &&&ScalarVariable<'_>| {
        matches!(
            v.causality,
            Causality::Parameter | Causality::Input | Causality::Independent
        )
    };
    let started = |v: &&&ScalarVariable<'_>| v.start().is_some();
    let mut report = |rule, variable: &ScalarVariable<'_>, what: &str| {
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
