//! Checks of the files that an FMU has by the layered standard FMI-LS-REF: the manifest, parameter sets, experiments, and
//! reference results, with which runs are compared.

use std::collections::HashSet;
use std::time::Instant;

use anyhow::Result;
use fmu_description::ModelDescription;
use fmu_file::archive::Archive;
use fmu_file::references::{Experiment, FaultKind, MANIFEST, References, TABLE};
use fmu_file::text::quote;

use crate::Scope;
use crate::finding::{Findings, Location, find};
use crate::rule::rule;

/// A run whose results are compared with reference results.
pub struct ReferenceRun<'a> {
    /// The experiment of the FMU, by its name; `None` for the default experiment.
    pub experiment: Option<&'a str>,
    /// The table of the reference results, as CSV.
    pub results: &'a str,
    /// The tolerance of the experiment, if it has one.
    pub tolerance: Option<f64>,
}

/// Performs a run, and returns the differences of the results, as sentences without full stops.
///
/// # Errors
/// The run fails, or the results cannot be compared.
pub type Perform<'a> = dyn Fn(&ReferenceRun<'_>) -> Result<Vec<String>> + 'a;

/// Checks the files, and performs the experiments if there is a way to do so, until the time is over.
pub fn check(
    model: &ModelDescription<'_>,
    archive: &mut Archive,
    scope: &Scope<'_>,
    findings: &mut Findings,
) {
    let Some(references) = References::read(archive) else { return };
    for fault in &references.faults {
        let rule = match fault.kind {
            FaultKind::Unreadable => rule!("references-readable"),
            FaultKind::Form => rule!("references-form"),
            FaultKind::Missing => rule!("references-exist"),
        };
        let location = Location { line: fault.line, ..fault.file.as_str().into() };
        findings.add(rule, location, &fault.text);
    }
    let variables = model.root.child("ModelVariables").into_iter();
    let variables = variables.flat_map(|list| &list.children);
    let names =
        variables.flat_map(|variable| [variable].into_iter().chain(variable.children("Alias")));
    let names: HashSet<_> = names.filter_map(|named| named.attribute("name")).collect();
    for set in &references.parameter_sets {
        for parameter in &set.parameters {
            // An element of an array has an index.
            let array = parameter.split('[').next().unwrap_or_default();
            if !names.contains(parameter.as_str()) && !names.contains(array) {
                find!(findings, "references-variables" at set.file.as_str(),
                    "the parameter is {}, expected the name of a variable", quote(parameter));
            }
        }
    }
    let Some(perform) = scope.perform else { return };
    for Experiment { name, references: results, tolerance, other_analysis, file, line, .. } in
        &references.experiments
    {
        let Some(results) = results.as_ref().filter(|_| other_analysis.is_none()) else { continue };
        let at = || Location { line: Some(*line), ..file.as_str().into() };
        if Instant::now() >= scope.deadline {
            find!(findings, "not-tested" at at(), "there was no time for the experiment {}", quote(name));
            return;
        }
        // A table of another type is no mistake.
        if results.of_type != TABLE || !archive.names.contains(&results.file) {
            continue;
        }
        let table = archive.text(&results.file).map(Option::unwrap_or_default);
        let differences = table.and_then(|results| {
            let experiment = Some(name.as_str());
            perform(&ReferenceRun { experiment, results: &results, tolerance: *tolerance })
        });
        let name = quote(name);
        match differences {
            Ok(differences) => differences.into_iter().for_each(|difference| {
                find!(findings, "experiment-results" at at(), "experiment {name}: {difference}");
            }),
            Err(error) => find!(findings, "experiment-results" at at(),
                "the experiment {name} cannot be performed: {error:#}"),
        }
    }
    // The standard does not say of which run a result is.
    if references.experiments.iter().any(|experiment| experiment.references.is_some()) {
        return;
    }
    let results = references.files.iter();
    let results = results.filter(|related| related.role == "result" && related.of_type == TABLE);
    for related in results.filter(|related| !related.is_elsewhere) {
        if Instant::now() >= scope.deadline {
            return find!(findings, "not-tested" at MANIFEST, "there was no time for {}", related.file);
        }
        let Ok(Some(results)) = archive.text(&related.file) else { continue };
        let run = ReferenceRun { experiment: None, results: &results, tolerance: None };
        let at = || Location { line: Some(related.line), ..MANIFEST.into() };
        match perform(&run) {
            Ok(differences) => differences.into_iter().for_each(|difference| {
                find!(findings, "default-results" at at(), "{}: {difference}", related.file);
            }),
            Err(error) => find!(findings, "default-results" at at(),
                "{} cannot be compared with the default experiment: {error:#}", related.file),
        }
    }
}
