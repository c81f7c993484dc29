//! All rules, and the application of those for a model description that its schema does not express.

pub mod definitions;
pub mod structure;
pub mod variables;

use fmu_description::{FmiVersion, ModelDescription};

use crate::finding::Findings;
use crate::rule::Rule;
use crate::{binary, package, schema};

/// All rules, by the part of the FMU that they are about.
pub fn rules() -> impl Iterator<Item = &'static Rule> {
    [
        package::ARCHIVE,
        package::EXPORTS,
        package::BUILD,
        package::TERMINALS,
        schema::SCHEMA,
        definitions::ROOT,
        definitions::DEFINITIONS,
        definitions::UNITS,
        definitions::TYPES,
        variables::NAMES,
        variables::VARIABLES,
        structure::STRUCTURE,
        variables::ARRAYS,
        variables::CLOCKS,
        binary::rules::BEHAVIOUR,
    ]
    .into_iter()
    .flatten()
}

/// Applies the rules of FMI 2.0.5 and FMI 3.0.2 for a model description.
pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    definitions::check(model, findings);
    variables::check(model, findings);
    structure::check(model, findings);
    if model.version == FmiVersion::Fmi3 {
        variables::check_fmi3(model, findings);
    }
}
