//! Rules for the model structure (FMI 2.0.5, section 2.2.8; FMI 3.0.2, section 2.4.8).

use std::collections::HashSet;

use fmu_description::value::{items, unsigned};
use fmu_description::xml::Element;
use fmu_description::{
    Causality, FmiVersion, Initial, Listed, ModelDescription, Type, Unknown, Variability,
};
use fmu_file::text::quote;

use super::definitions::{expected, float, is_clocked};
use crate::finding::{Findings, find, require};
use crate::rule::rules;

rules! {
    /// The model structure.
    pub STRUCTURE {
        INDEX_EXISTS: Error, "index-exists", Standard("section 2.2.8", "section 2.4.8"),
            "The index, in FMI 3.0 the value reference, of an unknown is that of a variable.";
        INDEX_ONCE: Error, "index-once", Standard("section 2.2.8", "section 2.4.8"),
            "A list of unknowns has each variable once.";
        DEPENDENCY_EXISTS: Error, "dependency-exists", Standard("section 2.2.8", "section 2.4.8"),
            "Dependencies are indices, in FMI 3.0 value references, of variables.";
        DEPENDENCY_ONCE: Error, "dependency-once", Fmi2("section 2.2.8"),
            "An unknown depends on each variable once.";
        DEPENDENCY_KINDS: Error, "dependency-kinds", Standard("section 2.2.8", "section 2.4.8"),
            "dependenciesKind has as many items as dependencies, and is given only with these.";
        DEPENDENCY_ORDER: Error, "dependency-order", Fmi2("section 2.2.8"),
            "dependencies are in ascending order.";
        DEPENDENCY_KIND_REAL: Error, "dependency-kind-real", Standard("section 2.2.8", "section 2.4.8"),
            "Only Reals, in FMI 3.0 Float32 and Float64, have dependencies that are constant, fixed, tunable or discrete.";
        DEPENDENCY_KNOWN: Warning, "dependency-known", Standard("section 2.2.8", "section 2.4.8"),
            "Outputs, derivatives and event indicators depend on no continuous output or local variable that is not a state.";
        INITIAL_KINDS: Error, "initial-kinds", Standard("section 2.2.8", "section 2.4.8"),
            "The dependencies of an initial unknown are dependent or constant.";
        INITIAL_KNOWN: Warning, "initial-known", Standard("section 2.2.8", "section 2.4.8"),
            "The dependencies of an initial unknown are inputs, the independent variable, and variables with initial exact.";
        OUTPUTS_LISTED: Error, "outputs-listed", Standard("section 2.2.8", "section 2.4.8"),
            "Outputs, in FMI 3.0 Output, lists all outputs.";
        ONLY_OUTPUTS_LISTED: Error, "only-outputs-listed", Standard("section 2.2.8", "section 2.4.8"),
            "Outputs, in FMI 3.0 Output, lists nothing but outputs.";
        DERIVATIVE_ATTRIBUTE: Error, "derivative-attribute", Standard("section 2.2.8", "section 2.4.8"),
            "The variables in Derivatives, in FMI 3.0 ContinuousStateDerivative, have the attribute derivative.";
        DERIVATIVE_CONTINUOUS: Error, "derivative-continuous", Standard("section 2.2.8", "section 2.4.8"),
            "The variables in Derivatives, in FMI 3.0 ContinuousStateDerivative, are continuous Reals.";
        DERIVATIVE_ONCE: Error, "derivative-once", Standard("section 2.2.8", "section 2.4.8"),
            "The variables in Derivatives, in FMI 3.0 ContinuousStateDerivative, are derivatives of different states, and not of themselves.";
        DERIVATIVE_SIZE: Error, "derivative-size", Fmi3("section 2.4.8"),
            "A variable in ContinuousStateDerivative has the dimensions of its state.";
        STATE_CAUSALITY: Error, "state-causality", Fmi3("section 2.4.7.4"),
            "Continuous states and event indicators are local or outputs.";
        CLOCKED_STATE: Error, "clocked-state", Fmi3("section 2.4.8"),
            "The variables in ClockedState are discrete and clocked, and have the attribute previous.";
        INDICATOR_CONTINUOUS: Error, "indicator-continuous", Fmi3("section 2.4.8"),
            "Event indicators are continuous Float32 or Float64.";
        INITIAL_UNKNOWNS_ORDER: Error, "initial-unknowns-order", Fmi2("section 2.2.8"),
            "InitialUnknowns is in ascending order of the indices.";
        INITIAL_UNKNOWNS_LISTED: Error, "initial-unknowns-listed", Standard("section 2.2.8", "section 2.4.8"),
            "InitialUnknowns, in FMI 3.0 InitialUnknown, lists the outputs, states and derivatives with initial approx or calculated, and the calculated parameters; clocked variables may be left out.";
        ONLY_INITIAL_UNKNOWNS_LISTED: Warning, "only-initial-unknowns-listed", Standard("section 2.2.8", "section 2.4.8"),
            "InitialUnknowns, in FMI 3.0 InitialUnknown, lists nothing else.";
    }
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
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
        each(name, unknowns, model, findings);
    }
    dependencies_known(model, findings);
    outputs(outputs_name, model, findings);
    derivatives(derivatives_name, model, findings);
    clocked_states_and_indicators(model, findings);
    initial_unknowns(initial_name, model, findings);
}

fn indices(unknowns: &[Unknown<'_>]) -> HashSet<usize> {
    unknowns
        .iter()
        .filter_map(|unknown| unknown.index)
        .collect()
}

/// Checks the references and dependencies of the unknowns in a list.
fn each(
    list: &str,
    unknowns: &[Unknown<'_>],
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    let reference = match model.version {
        FmiVersion::Fmi2 => "index",
        FmiVersion::Fmi3 => "value reference",
    };
    let mut seen = HashSet::new();
    for unknown in unknowns {
        let (at, number) = (unknown.element, unknown.number);
        require!(findings, INDEX_EXISTS at at, unknown.index.is_some(),
            "{list} has the {reference} {number}, expected {}", expected(model));
        require!(findings, INDEX_ONCE at at, seen.insert(number),
            "{list} has the {reference} {number} twice, expected it once");
        let dependencies = unknown.dependencies.as_deref().unwrap_or_default();
        if let Some(wrong) = (dependencies.iter()).find(|number| model.index(**number).is_none()) {
            find!(findings, DEPENDENCY_EXISTS at at,
                "dependencies has {wrong}, expected {}", expected(model));
        }
        if model.version == FmiVersion::Fmi2 {
            order(at, dependencies, findings);
        }
        kinds(list, unknown, model, findings);
    }
}

/// Checks that dependencies are ascending, as in FMI 2.0.
fn order(at: &Element<'_>, dependencies: &[u32], findings: &mut Findings) {
    let different: HashSet<_> = dependencies.iter().collect();
    require!(findings, DEPENDENCY_ONCE at at, different.len() == dependencies.len(),
        "dependencies has an index twice, expected each once");
    if let Some([first, second]) = dependencies.windows(2).find(|pair| pair[0] > pair[1]) {
        find!(findings, DEPENDENCY_ORDER at at,
            "dependencies has {second} after {first}, expected ascending order");
    }
}

/// Checks the kinds of the dependencies of an unknown.
fn kinds(list: &str, unknown: &Unknown<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let at = unknown.element;
    let Some(kinds) = at.attribute("dependenciesKind") else {
        return;
    };
    let count = items(kinds).count();
    match unknown.dependencies.as_ref().map(Vec::len) {
        None => find!(findings, DEPENDENCY_KINDS at at,
            "dependenciesKind is given without dependencies, expected both"),
        Some(all) => require!(findings, DEPENDENCY_KINDS at at, all == count,
            "dependenciesKind has {count} items, expected {all}, one per dependency"),
    }
    let variable = model.variable(unknown.index);
    if variable.is_some_and(|v| !v.of_type.is_float())
        && let Some(kind) = items(kinds).find(|kind| *kind != "dependent")
    {
        let (kind, float) = (quote(kind), float(model));
        find!(findings, DEPENDENCY_KIND_REAL at at,
            "dependenciesKind has {kind}, expected dependent for what is not a {float}");
    }
    let is_initial = |kind: &&str| matches!(*kind, "dependent" | "constant");
    if list.starts_with("InitialUnknown")
        && let Some(kind) = items(kinds).find(|kind| !is_initial(kind))
    {
        find!(findings, INITIAL_KINDS at at,
            "dependenciesKind has {}, expected dependent or constant", quote(kind));
    }
}

fn outputs(list: &str, model: &ModelDescription<'_>, findings: &mut Findings) {
    let listed = indices(&model.outputs);
    for (index, variable) in model.variables() {
        let is_output = variable.causality == Causality::Output;
        let is_listed = listed.contains(&index);
        require!(findings, OUTPUTS_LISTED at variable, !is_output || is_listed,
            "the output is not in {list} of ModelStructure, expected it there");
        require!(findings, ONLY_OUTPUTS_LISTED at variable, is_output || !is_listed,
            "it is in {list} of ModelStructure, expected outputs only");
    }
}

/// The index of the state that a variable is the derivative of.
fn state_of(variable: &Listed<'_>, model: &ModelDescription<'_>) -> Option<usize> {
    model.index(unsigned(variable.value.attribute("derivative")?)?)
}

fn derivatives(list: &str, model: &ModelDescription<'_>, findings: &mut Findings) {
    let mut states = HashSet::new();
    for unknown in &model.derivatives {
        let Some(variable) = model.variable(unknown.index) else {
            continue;
        };
        let is_derivative = variable.value.has("derivative");
        let is_continuous = variable.variability == Variability::Continuous;
        require!(findings, DERIVATIVE_ATTRIBUTE at variable, is_derivative,
            "it is in {list} of ModelStructure, expected it to have the attribute derivative");
        require!(findings, DERIVATIVE_CONTINUOUS at variable, is_continuous || !is_derivative,
            "it is in {list} of ModelStructure, expected its variability to be continuous");
        let index = state_of(variable, model);
        let Some(state) = model.variable(index) else {
            continue;
        };
        let name = quote(&state.name);
        require!(findings, DERIVATIVE_ONCE at variable,
            index != unknown.index && states.insert(index),
            "it is in {list} of ModelStructure as derivative of {name}, expected a state that has no \
             other derivative there");
        if model.version == FmiVersion::Fmi3 {
            state_causality(state, "the state", findings);
            require!(findings, DERIVATIVE_SIZE at variable, sizes(variable) == sizes(state),
                "it is the derivative of {name}, expected the same dimensions");
        }
    }
}

/// The dimensions of a variable, each a number or a value reference.
fn sizes<'a>(variable: &Listed<'a>) -> Vec<[Option<&'a str>; 2]> {
    let size = |d: &'a Element<'a>| ["start", "valueReference"].map(|name| d.attribute(name));
    (variable.element.children("Dimension")).map(size).collect()
}

/// Checks that what is listed depends on no other unknowns. An FMU for co-simulation may hide its
/// states, so that nothing is known about its variables.
fn dependencies_known(model: &ModelDescription<'_>, findings: &mut Findings) {
    if model.derivatives.is_empty() && model.model_exchange().is_none() {
        return;
    }
    let states: HashSet<usize> = (model.variables())
        .filter_map(|(_, variable)| state_of(variable, model))
        .collect();
    let is_unknown = |index: &usize| {
        model.variable(*index).is_some_and(|variable| {
            matches!(variable.causality, Causality::Local | Causality::Output)
                && variable.variability == Variability::Continuous
                && variable.of_type.is_float()
                && !states.contains(index)
        })
    };
    let lists = [&model.outputs, &model.derivatives, &model.event_indicators];
    for unknown in lists.into_iter().flatten() {
        let dependencies = unknown.dependencies.iter().flatten();
        let mut indices = dependencies.filter_map(|number| model.index(*number));
        if let Some(other) = model.variable(indices.find(is_unknown)) {
            find!(findings, DEPENDENCY_KNOWN at unknown.element,
                "dependencies has {}, which is computed, expected inputs, states and the independent \
                 variable", quote(&other.name));
        }
    }
}

/// Checks that a state or event indicator is computed by the FMU.
fn state_causality(variable: &Listed<'_>, what: &str, findings: &mut Findings) {
    let causality = variable.causality;
    require!(findings, STATE_CAUSALITY at variable,
        matches!(causality, Causality::Local | Causality::Output),
        "{what} has causality {}, expected local or output", causality.as_str());
}

fn clocked_states_and_indicators(model: &ModelDescription<'_>, findings: &mut Findings) {
    for variable in (model.clocked_states.iter()).filter_map(|u| model.variable(u.index)) {
        let is_discrete = variable.variability == Variability::Discrete;
        let has_previous = variable.element.has("previous");
        require!(findings, CLOCKED_STATE at variable,
            has_previous && is_clocked(variable) && is_discrete,
            "it is in ClockedState, expected it to be discrete and to have the attributes clocks and \
             previous");
    }
    for variable in (model.event_indicators.iter()).filter_map(|u| model.variable(u.index)) {
        let is_continuous = variable.variability == Variability::Continuous;
        require!(findings, INDICATOR_CONTINUOUS at variable,
            variable.of_type.is_float() && is_continuous,
            "it is in EventIndicator, expected a continuous {}", float(model));
        state_causality(variable, "the event indicator", findings);
    }
}

/// Checks that `InitialUnknowns` lists exactly the variables that are computed during initialization.
fn initial_unknowns(list: &str, model: &ModelDescription<'_>, findings: &mut Findings) {
    let unknowns = &model.initial_unknowns;
    let descent = unknowns
        .windows(2)
        .find(|pair| pair[0].number > pair[1].number);
    if let Some([first, second]) = descent.filter(|_| model.version == FmiVersion::Fmi2) {
        find!(findings, INITIAL_UNKNOWNS_ORDER at second.element,
            "InitialUnknowns has the index {} after {}, expected ascending order",
            second.number, first.number);
    }
    for unknown in unknowns {
        initial_known(unknown, model, findings);
    }
    let listed = indices(unknowns);
    let mut of_states = HashSet::new();
    for unknown in &model.derivatives {
        of_states.extend(unknown.index);
        of_states.extend((model.variable(unknown.index)).and_then(|v| state_of(v, model)));
    }
    // An FMU may or may not initialize its clocked variables.
    for (index, variable) in model.variables().filter(|(_, v)| !is_clocked(v)) {
        let is_computed = matches!(
            variable.initial,
            Some(Initial::Approx | Initial::Calculated)
        );
        let is_unknown = match variable.causality {
            Causality::CalculatedParameter => true,
            Causality::Output => is_computed,
            _ => is_computed && of_states.contains(&index),
        };
        let is_listed = listed.contains(&index);
        require!(findings, INITIAL_UNKNOWNS_LISTED at variable, is_listed || !is_unknown,
            "it is computed during initialization but not in {list} of ModelStructure, expected it \
             there");
        require!(findings, ONLY_INITIAL_UNKNOWNS_LISTED at variable, is_unknown || !is_listed,
            "it is in {list} of ModelStructure, expected outputs, calculated parameters, states and \
             derivatives that are computed");
    }
}

/// Checks that an initial unknown depends on what is known then.
fn initial_known(unknown: &Unknown<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
    let is_known = |variable: &Listed<'_>| {
        matches!(
            variable.causality,
            Causality::Input | Causality::Independent
        ) || variable.initial == Some(Initial::Exact)
            || variable.of_type == Type::Clock
            || is_clocked(variable)
    };
    let dependencies = unknown.dependencies.iter().flatten();
    let mut variables = dependencies.filter_map(|number| model.variable(model.index(*number)));
    if let Some(other) = variables.find(|variable| !is_known(variable)) {
        find!(findings, INITIAL_KNOWN at unknown.element,
            "dependencies has {}, which is computed, expected inputs, the independent variable, and \
             variables with initial exact", quote(&other.name));
    }
}
