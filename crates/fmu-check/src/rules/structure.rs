//! Rules for the model structure (FMI 2.0.4, section 2.2.8).

use std::collections::HashSet;

use fmu_description::value::{items, unsigned};
use fmu_description::{Causality, Initial, ModelDescription, ScalarVariable, Unknown};

use crate::finding::Findings;

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
            findings.error(
                unknown.element,
                format!(
                    "{list} has the index {}, expected 1 to {count}",
                    unknown.index
                ),
            );
        }
        if !seen.insert(unknown.index) {
            findings.error(
                unknown.element,
                format!(
                    "{list} has the index {} twice, expected it once",
                    unknown.index
                ),
            );
        }
        let dependencies = unknown.dependencies.as_deref().unwrap_or_default();
        if let Some(wrong) = dependencies.iter().find(|index| !exists(**index as usize)) {
            findings.error(
                unknown.element,
                format!("dependencies has {wrong}, expected indices from 1 to {count}"),
            );
        }
        if dependencies.iter().collect::<HashSet<_>>().len() < dependencies.len() {
            findings.error(
                unknown.element,
                "dependencies has an index twice, expected each once",
            );
        }
        let kinds = unknown
            .element
            .attribute("dependenciesKind")
            .map(|kinds| items(kinds).count());
        if let Some(kinds) = kinds
            && kinds != dependencies.len()
        {
            findings.error(
                unknown.element,
                format!(
                    "dependenciesKind has {kinds} items, expected {}, one per dependency",
                    dependencies.len()
                ),
            );
        }
    }
}

fn outputs(model: &ModelDescription<'_>, findings: &mut Findings) {
    let listed = indices(&model.outputs);
    for (index, variable) in model.variables() {
        let is_output = variable.causality == Causality::Output;
        if is_output && !listed.contains(&index) {
            findings.error(
                variable,
                "the output is not in Outputs of ModelStructure, expected it there",
            );
        }
        if !is_output && listed.contains(&index) {
            findings.error(
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
        if let Some(variable) = model.variable(unknown.index)
            && state_of(variable).is_none()
        {
            findings.error(
                variable,
                "it is in Derivatives of ModelStructure, expected it to have the attribute derivative",
            );
        }
    }
}

/// Checks that `InitialUnknowns` lists exactly the variables that are computed during initialization.
fn initial_unknowns(model: &ModelDescription<'_>, findings: &mut Findings) {
    let listed = indices(&model.initial_unknowns);
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
            findings.error(
                variable,
                "it is computed during initialization but not in InitialUnknowns of ModelStructure, expected it there",
            );
        }
        if !unknown && listed.contains(&index) {
            findings.warning(
                variable,
                "it is in InitialUnknowns of ModelStructure, expected outputs, calculated parameters, states and derivatives that are computed",
            );
        }
    }
}
