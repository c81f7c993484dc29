//! The rules of FMI 2.0.5 and FMI 3.0.2 for a model description that its schema does not express.

pub mod definitions;
pub mod fmi3;
pub mod root;
pub mod structure;
pub mod variables;

use fmu_description::{FmiVersion, ModelDescription};

use crate::finding::Findings;

/// Applies all rules.
pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    root::check(model, findings);
    definitions::check(model, findings);
    variables::check(model, findings);
    structure::check(model, findings);
    if model.version == FmiVersion::Fmi3 {
        fmi3::check(model, findings);
    }
}
