//! Rules for the model structure (FMI 2.0.5, section 2.2.8).

use std::collections::HashSet;

use fmu_description::value::{items, unsigned};
use fmu_description::{
    Causality, Initial, ModelDescription, ScalarVariable, Unknown, Variability, VariableType,
};

use crate::finding::Findings;
use crate::rule::rules;
use fmu_file::text::quote;

rules! {
    /// The model structure.
    pub STRUCTURE {
        INDEX_EXISTS: Error, "index-exists", Standard("section 2.2.8"),
            "The index of an unknown is that of a variable.";
        INDEX_ONCE: Error, "index-once", Standard("section 2.2.8"),
            "A list of unknowns has each variable once.";
        DEPENDENCY_EXISTS: Error, "dependency-exists", Standard("section 2.2.8"),
            "Dependencies are indices of variables.";
        DEPENDENCY_ONCE: Error, "dependency-once", Standard("section 2.2.8"),
            "An unknown depends on each variable once.";
        DEPENDENCY_KINDS: Error, "dependency-kinds", Standard("section 2.2.8"),
            "dependenciesKind has as many items as dependencies, and is given only with these.";
        DEPENDENCY_ORDER: Error, "dependency-order", Standard("section 2.2.8"),
            "dependencies are in ascending order.";
        DEPENDENCY_KIND_REAL: Error, "dependency-kind-real", Standard("section 2.2.8"),
            "Only Reals have dependencies that are constant, fixed, tunable or discrete.";
        INITIAL_KINDS: Error, "initial-kinds", Standard("section 2.2.8"),
            "The dependencies of an initial unknown are dependent or constant.";
        OUTPUTS_LISTED: Error, "outputs-listed", Standard("section 2.2.8"),
            "Outputs lists all outputs.";
        ONLY_OUTPUTS_LISTED: Error, "only-outputs-listed", Standard("section 2.2.8"),
            "Outputs lists nothing but outputs.";
        DERIVATIVE_ATTRIBUTE: Error, "derivative-attribute", Standard("section 2.2.8"),
            "The variables in Derivatives have the attribute derivative.";
        DERIVATIVE_CONTINUOUS: Error, "derivative-continuous", Standard("section 2.2.8"),
            "The variables in Derivatives are continuous Reals.";
        INITIAL_UNKNOWNS_ORDER: Error, "initial-unknowns-order", Standard("section 2.2.8"),
            "InitialUnknowns is in ascending order of the indices.";
        INITIAL_UNKNOWNS_LISTED: Error, "initial-unknowns-listed", Standard("section 2.2.8"),
            "InitialUnknowns lists the outputs, states and derivatives with initial approx or calculated, and the calculated parameters.";
        ONLY_INITIAL_UNKNOWNS_LISTED: Warning, "only-initial-unknowns-listed", Standard("section 2.2.8"),
            "InitialUnknowns lists nothing else.";
    }
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    for (list, unknowns) in [
        ("Outputs", &model.outputs),
        ("Derivatives", &model.derivatives),
        ("InitialUnknowns", &model.initial_unknowns),
    ] {
        each(list, unknowns, model, findings);
    }
    outputs(model, findings);
    derivatives(model, findings);
    initial_unknowns(model, findings);
}

fn indices(unknowns: &[Unknown<'_>]) -> HashSet<usize> {
    unknowns.iter().map(|unknown| unknown.index).collect()
}

/// Checks the indices and dependencies of the unknowns in a list.
fn each(
    list: &str,
    unknowns: &[Unknown<'_>],
    model: &ModelDescription<'_>,
    findings: &mut Findings,
) {
    let count = model.variables.len();
    let exists = |index: usize| (1..=count).contains(&index);
    let mut seen = HashSet::new();
    for unknown in unknowns {
        if !exists(unknown.index) {
            findings.add(
                &INDEX_EXISTS,
                unknown.element,
                format!(
                    "{list} has the index {}, expected 1 to {count}",
                    unknown.index
                ),
            );
        }
        if !seen.insert(unknown.index) {
            findings.add(
                &INDEX_ONCE,
                unknown.element,
                format!(
                    "{list} has the index {} twice, expected it once",
                    unknown.index
                ),
            );
        }
        let dependencies = unknown.dependencies.as_deref().unwrap_or_default();
        if let Some(wrong) = dependencies.iter().find(|index| !exists(**index as usize)) {
            findings.add(
                &DEPENDENCY_EXISTS,
                unknown.element,
                format!("dependencies has {wrong}, expected indices from 1 to {count}"),
            );
        }
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
        kinds(list, unknown, model, findings);
    }
}

/// Checks the kinds of the dependencies of an unknown.
fn kinds(list: &str, unknown: &Unknown<'_>, model: &ModelDescription<'_>, findings: &mut Findings) {
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
        .is_some_and(|v| v.kind != VariableType::Real)
        && let Some(kind) = items(kinds).find(|kind| *kind != "dependent")
    {
        let text = format!(
            "dependenciesKind has {}, expected dependent for what is not a Real",
            quote(kind)
        );
        findings.add(&DEPENDENCY_KIND_REAL, unknown.element, text);
    }
    let is_initial = |kind: &&str| matches!(*kind, "dependent" | "constant");
    if list == "InitialUnknowns"
        && let Some(kind) = items(kinds).find(|kind| !is_initial(kind))
    {
        let text = format!(
            "dependenciesKind has {}, expected dependent or constant",
            quote(kind)
        );
        findings.add(&INITIAL_KINDS, unknown.element, text);
    }
}

fn outputs(model: &ModelDescription<'_>, findings: &mut Findings) {
    let listed = indices(&model.outputs);
    for (index, variable) in model.variables() {
        let is_output = variable.causality == Causality::Output;
        if is_output && !listed.contains(&index) {
            findings.add(
                &OUTPUTS_LISTED,
                variable,
                "the output is not in Outputs of ModelStructure, expected it there",
            );
        }
        if !is_output && listed.contains(&index) {
            findings.add(
                &ONLY_OUTPUTS_LISTED,
                variable,
                "it is in Outputs of ModelStructure, expected outputs only",
            );
        }
    }
}

/// The index of the state that a variable is the derivative of.
fn state_of(variable: &ScalarVariable<'_>) -> Option<usize> {
    let index = variable.value.attribute("derivative")?;
    Some(unsigned(index)? as usize)
}

fn derivatives(model: &ModelDescription<'_>, findings: &mut Findings) {
    for unknown in &model.derivatives {
        let Some(variable) = model.variable(unknown.index) else {
            continue;
        };
        if state_of(variable).is_none() {
            findings.add(
                &DERIVATIVE_ATTRIBUTE,
                variable,
                "it is in Derivatives of ModelStructure, expected it to have the attribute derivative",
            );
        } else if variable.variability != Variability::Continuous {
            findings.add(
                &DERIVATIVE_CONTINUOUS,
                variable,
                "it is in Derivatives of ModelStructure, expected its variability to be continuous",
            );
        }
    }
}

/// Checks that `InitialUnknowns` lists exactly the variables that are computed during initialization.
fn initial_unknowns(model: &ModelDescription<'_>, findings: &mut Findings) {
    let listed = indices(&model.initial_unknowns);
    if let Some(pair) =
        (model.initial_unknowns.windows(2)).find(|pair| pair[0].index > pair[1].index)
    {
        let (first, second) = (pair[0].index, pair[1].index);
        let text = format!(
            "InitialUnknowns has the index {second} after {first}, expected ascending order"
        );
        findings.add(&INITIAL_UNKNOWNS_ORDER, pair[1].element, text);
    }
    let mut of_states = HashSet::new();
    for unknown in &model.derivatives {
        of_states.insert(unknown.index);
        of_states.extend(model.variable(unknown.index).and_then(state_of));
    }
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
        if unknown && !listed.contains(&index) {
            findings.add(&INITIAL_UNKNOWNS_LISTED, variable,
                "it is computed during initialization but not in InitialUnknowns of ModelStructure, expected it there",
            );
        }
        if !unknown && listed.contains(&index) {
            findings.add(&ONLY_INITIAL_UNKNOWNS_LISTED, variable,
                "it is in InitialUnknowns of ModelStructure, expected outputs, calculated parameters, states and derivatives that are computed",
            );
        }
    }
}
