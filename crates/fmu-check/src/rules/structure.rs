//! Rules for the model structure (FMI 2.0.5, section 2.2.8; FMI 3.0.2, section 2.4.8).

use std::collections::HashSet;

use fmu_description::value::{items, unsigned};
use fmu_description::xml::Element;

use fmu_description::{Causality, FmiVersion, Initial, Variability};

use super::{Kind, Model, Unknown, Variable};
use crate::finding::Findings;
use crate::rule::rules;
use fmu_file::text::quote;

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

/// A list of unknowns, for messages.
struct List {
    name: &'static str,
    /// How it refers to variables.
    reference: &'static str,
}

/// The names of `Outputs`, `Derivatives` and `InitialUnknowns`.
fn names(version: FmiVersion) -> [&'static str; 3] {
    match version {
        FmiVersion::Fmi2 => ["Outputs", "Derivatives", "InitialUnknowns"],
        FmiVersion::Fmi3 => ["Output", "ContinuousStateDerivative", "InitialUnknown"],
    }
}

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    let [outputs_name, derivatives_name, initial_name] = names(model.version);
    let reference = match model.version {
        FmiVersion::Fmi2 => "index",
        FmiVersion::Fmi3 => "value reference",
    };
    for (name, unknowns) in [
        (outputs_name, &model.outputs),
        (derivatives_name, &model.derivatives),
        ("ClockedState", &model.clocked_states),
        (initial_name, &model.initial_unknowns),
        ("EventIndicator", &model.event_indicators),
    ] {
        each(&List { name, reference }, unknowns, model, findings);
    }
    dependencies_known(model, findings);
    outputs(model, findings);
    derivatives(model, findings);
    clocked_states(model, findings);
    event_indicators(model, findings);
    initial_unknowns(model, findings);
}

fn indices(unknowns: &[Unknown<'_>]) -> HashSet<usize> {
    (unknowns.iter())
        .filter_map(|unknown| unknown.index)
        .collect()
}

/// Checks the references and dependencies of the unknowns in a list.
fn each(list: &List, unknowns: &[Unknown<'_>], model: &Model<'_>, findings: &mut Findings) {
    let List { name, reference } = list;
    let expected = || model.expected();
    let mut seen = HashSet::new();
    for unknown in unknowns {
        let (at, number) = (unknown.element, unknown.number);
        if unknown.index.is_none() {
            let text = format!(
                "{name} has the {reference} {number}, expected {}",
                expected()
            );
            findings.add(&INDEX_EXISTS, at, text);
        }
        if !seen.insert(number) {
            let text = format!("{name} has the {reference} {number} twice, expected it once");
            findings.add(&INDEX_ONCE, at, text);
        }
        let dependencies = unknown.dependencies.as_deref().unwrap_or_default();
        if let Some(wrong) = (dependencies.iter()).find(|number| model.index(**number).is_none()) {
            let text = format!("dependencies has {wrong}, expected {}", expected());
            findings.add(&DEPENDENCY_EXISTS, at, text);
        }
        if model.version == FmiVersion::Fmi2 {
            order(unknown, dependencies, findings);
        }
        kinds(name, unknown, model, findings);
    }
}

/// Checks that dependencies are ascending, as in FMI 2.0.
fn order(unknown: &Unknown<'_>, dependencies: &[u32], findings: &mut Findings) {
    if dependencies.iter().collect::<HashSet<_>>().len() < dependencies.len() {
        findings.add(
            &DEPENDENCY_ONCE,
            unknown.element,
            "dependencies has an index twice, expected each once",
        );
    }
    if let Some(pair) = dependencies.windows(2).find(|pair| pair[0] > pair[1]) {
        let (first, second) = (pair[0], pair[1]);
        let text = format!("dependencies has {second} after {first}, expected ascending order");
        findings.add(&DEPENDENCY_ORDER, unknown.element, text);
    }
}

/// Checks the kinds of the dependencies of an unknown.
fn kinds(list: &str, unknown: &Unknown<'_>, model: &Model<'_>, findings: &mut Findings) {
    let Some(kinds) = unknown.element.attribute("dependenciesKind") else {
        return;
    };
    let count = items(kinds).count();
    let text = match &unknown.dependencies {
        None => "dependenciesKind is given without dependencies, expected both".to_owned(),
        Some(all) => format!(
            "dependenciesKind has {count} items, expected {}, one per dependency",
            all.len()
        ),
    };
    if unknown.dependencies.as_ref().map(Vec::len) != Some(count) {
        findings.add(&DEPENDENCY_KINDS, unknown.element, text);
    }
    if model
        .variable(unknown.index)
        .is_some_and(|v| v.kind != Kind::Float)
        && let Some(kind) = items(kinds).find(|kind| *kind != "dependent")
    {
        let text = format!(
            "dependenciesKind has {}, expected dependent for what is not a {}",
            quote(kind),
            model.float()
        );
        findings.add(&DEPENDENCY_KIND_REAL, unknown.element, text);
    }
    let is_initial = |kind: &&str| matches!(*kind, "dependent" | "constant");
    if list.starts_with("InitialUnknown")
        && let Some(kind) = items(kinds).find(|kind| !is_initial(kind))
    {
        let text = format!(
            "dependenciesKind has {}, expected dependent or constant",
            quote(kind)
        );
        findings.add(&INITIAL_KINDS, unknown.element, text);
    }
}

fn outputs(model: &Model<'_>, findings: &mut Findings) {
    let listed = indices(&model.outputs);
    let [list, ..] = names(model.version);
    for (index, variable) in model.variables() {
        let is_output = variable.causality == Causality::Output;
        if is_output && !listed.contains(&index) {
            let text = format!("the output is not in {list} of ModelStructure, expected it there");
            findings.add(&OUTPUTS_LISTED, variable, text);
        }
        if !is_output && listed.contains(&index) {
            let text = format!("it is in {list} of ModelStructure, expected outputs only");
            findings.add(&ONLY_OUTPUTS_LISTED, variable, text);
        }
    }
}

/// The index of the state that a variable is the derivative of.
fn state_of(variable: &Variable<'_>, model: &Model<'_>) -> Option<usize> {
    model.index(unsigned(variable.value.attribute("derivative")?)?)
}

fn derivatives(model: &Model<'_>, findings: &mut Findings) {
    let [_, list, _] = names(model.version);
    let mut states = HashSet::new();
    for unknown in &model.derivatives {
        let Some(variable) = model.variable(unknown.index) else {
            continue;
        };
        if variable.value.attribute("derivative").is_none() {
            let text = format!(
                "it is in {list} of ModelStructure, expected it to have the attribute derivative"
            );
            findings.add(&DERIVATIVE_ATTRIBUTE, variable, text);
        } else if variable.variability != Variability::Continuous {
            let text = format!(
                "it is in {list} of ModelStructure, expected its variability to be continuous"
            );
            findings.add(&DERIVATIVE_CONTINUOUS, variable, text);
        }
        let index = state_of(variable, model);
        let Some(state) = model.variable(index) else {
            continue;
        };
        if index == unknown.index || !states.insert(index) {
            let text = format!(
                "it is in {list} of ModelStructure as derivative of {}, expected a state that has no other derivative there",
                quote(state.name)
            );
            findings.add(&DERIVATIVE_ONCE, variable, text);
        }
        if model.version == FmiVersion::Fmi3 {
            state_causality(state, "the state", findings);
            if dimensions(variable) != dimensions(state) {
                let text = format!(
                    "it is the derivative of {}, expected the same dimensions",
                    quote(state.name)
                );
                findings.add(&DERIVATIVE_SIZE, variable, text);
            }
        }
    }
}

/// The dimensions of a variable, each a number or a value reference.
fn dimensions<'a>(variable: &Variable<'a>) -> Vec<[Option<&'a str>; 2]> {
    let size = |d: &'a Element<'a>| ["start", "valueReference"].map(|name| d.attribute(name));
    (variable.element.children("Dimension")).map(size).collect()
}

/// Checks that what is listed depends on no other unknowns. An FMU for co-simulation may hide its
/// states, so that nothing is known about its variables.
fn dependencies_known(model: &Model<'_>, findings: &mut Findings) {
    if model.derivatives.is_empty() && model.root.child("ModelExchange").is_none() {
        return;
    }
    let states: HashSet<usize> = (model.variables())
        .filter_map(|(_, variable)| state_of(variable, model))
        .collect();
    let is_unknown = |index: &usize| {
        model.variable(Some(*index)).is_some_and(|variable| {
            matches!(variable.causality, Causality::Local | Causality::Output)
                && variable.variability == Variability::Continuous
                && variable.kind == Kind::Float
                && !states.contains(index)
        })
    };
    let lists = [&model.outputs, &model.derivatives, &model.event_indicators];
    for unknown in lists.into_iter().flatten() {
        let dependencies = unknown.dependencies.iter().flatten();
        let mut indices = dependencies.filter_map(|number| model.index(*number));
        if let Some(other) = model.variable(indices.find(is_unknown)) {
            let text = format!(
                "dependencies has {}, which is computed, expected inputs, states and the independent variable",
                quote(other.name)
            );
            findings.add(&DEPENDENCY_KNOWN, unknown.element, text);
        }
    }
}

/// Checks that a state or event indicator is computed by the FMU.
fn state_causality(variable: &Variable<'_>, what: &str, findings: &mut Findings) {
    if !matches!(variable.causality, Causality::Local | Causality::Output) {
        let causality = variable.causality.as_str();
        let text = format!("{what} has causality {causality}, expected local or output");
        findings.add(&STATE_CAUSALITY, variable, text);
    }
}

fn clocked_states(model: &Model<'_>, findings: &mut Findings) {
    for unknown in &model.clocked_states {
        if let Some(variable) = model.variable(unknown.index)
            && (variable.element.attribute("previous").is_none()
                || !variable.is_clocked()
                || variable.variability != Variability::Discrete)
        {
            let text = "it is in ClockedState, expected it to be discrete and to have the attributes clocks and previous";
            findings.add(&CLOCKED_STATE, variable, text);
        }
    }
}

fn event_indicators(model: &Model<'_>, findings: &mut Findings) {
    for unknown in &model.event_indicators {
        let Some(variable) = model.variable(unknown.index) else {
            continue;
        };
        if variable.kind != Kind::Float || variable.variability != Variability::Continuous {
            let text = format!(
                "it is in EventIndicator, expected a continuous {}",
                model.float()
            );
            findings.add(&INDICATOR_CONTINUOUS, variable, text);
        }
        state_causality(variable, "the event indicator", findings);
    }
}

/// Checks that `InitialUnknowns` lists exactly the variables that are computed during initialization.
fn initial_unknowns(model: &Model<'_>, findings: &mut Findings) {
    let listed = indices(&model.initial_unknowns);
    if model.version == FmiVersion::Fmi2
        && let Some(pair) =
            (model.initial_unknowns.windows(2)).find(|pair| pair[0].number > pair[1].number)
    {
        let (first, second) = (pair[0].number, pair[1].number);
        let text = format!(
            "InitialUnknowns has the index {second} after {first}, expected ascending order"
        );
        findings.add(&INITIAL_UNKNOWNS_ORDER, pair[1].element, text);
    }
    for unknown in &model.initial_unknowns {
        initial_known(unknown, model, findings);
    }
    let mut of_states = HashSet::new();
    for unknown in &model.derivatives {
        of_states.extend(unknown.index);
        of_states.extend((model.variable(unknown.index)).and_then(|v| state_of(v, model)));
    }
    let [.., list] = names(model.version);
    for (index, variable) in model.variables() {
        let computed = matches!(
            variable.initial,
            Some(Initial::Approx | Initial::Calculated)
        );
        let unknown = match variable.causality {
            Causality::CalculatedParameter => true,
            Causality::Output => computed,
            _ => computed && of_states.contains(&index),
        };
        // An FMU may or may not initialize its clocked variables.
        if variable.is_clocked() {
            continue;
        }
        if unknown && !listed.contains(&index) {
            let text = format!(
                "it is computed during initialization but not in {list} of ModelStructure, \
                 expected it there"
            );
            findings.add(&INITIAL_UNKNOWNS_LISTED, variable, text);
        }
        if !unknown && listed.contains(&index) {
            let text = format!(
                "it is in {list} of ModelStructure, expected outputs, calculated parameters, \
                 states and derivatives that are computed"
            );
            findings.add(&ONLY_INITIAL_UNKNOWNS_LISTED, variable, text);
        }
    }
}

/// Checks that an initial unknown depends on what is known then.
fn initial_known(unknown: &Unknown<'_>, model: &Model<'_>, findings: &mut Findings) {
    let dependencies = unknown.dependencies.as_deref().unwrap_or_default();
    let known = |variable: &Variable<'_>| {
        matches!(
            variable.causality,
            Causality::Input | Causality::Independent
        ) || variable.initial == Some(Initial::Exact)
            || variable.kind == Kind::Clock
            || variable.is_clocked()
    };
    let mut dependencies = dependencies
        .iter()
        .filter_map(|number| model.variable(model.index(*number)));
    if let Some(other) = dependencies.find(|variable| !known(variable)) {
        let text = format!(
            "dependencies has {}, which is computed, expected inputs, the independent variable, and \
             variables with initial exact",
            quote(other.name)
        );
        findings.add(&INITIAL_KNOWN, unknown.element, text);
    }
}
