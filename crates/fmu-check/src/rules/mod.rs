//! The rules of FMI 2.0.5 and FMI 3.0.2 for a model description that its schema does not express.

pub mod arrays;
pub mod clocks;
pub mod names;
pub mod root;
pub mod structure;
pub mod types;
pub mod units;
pub mod variables;
mod view;

use std::collections::HashSet;

use fmu_description::FmiVersion;
use fmu_description::xml::Element;
use fmu_file::text::quote;

use super::finding::Findings;
use super::rule::rules;
pub use view::Variable;
use view::{Kind, Model, Unknown};

rules! {
    /// Names of units, types, items and log categories.
    pub DEFINITIONS {
        NAMES_GIVEN: Error, "definition-named", Standard("section 2.2", "section 2.4"),
            "Units, types, items, log categories and tools have a name.";
        NAMES_UNIQUE: Error, "definition-unique", Standard("section 2.2", "section 2.4"),
            "Names of units, types, items, log categories and tools are unique.";
    }
}

/// Applies all rules.
pub fn check(root: &Element<'_>, findings: &mut Findings) {
    let model = &Model::new(root, findings.version());
    root::check(model, findings);
    units::check(model, findings);
    types::check(model, findings);
    names::check(model, findings);
    variables::check(model, findings);
    structure::check(model, findings);
    if model.version == FmiVersion::Fmi3 {
        arrays::check(model, findings);
        clocks::check(model, findings);
    }
}

/// Collects the names of elements, which must be unique.
fn unique<'a>(
    elements: impl Iterator<Item = &'a Element<'a>>,
    what: &str,
    findings: &mut Findings,
) -> HashSet<&'a str> {
    let mut names = HashSet::new();
    for element in elements {
        let Some(name) = element.attribute("name") else {
            continue;
        };
        if name.is_empty() {
            findings.add(
                &NAMES_GIVEN,
                element,
                format!("the name of a {what} is empty, expected a string"),
            );
        }
        if !names.insert(name) {
            findings.add(
                &NAMES_UNIQUE,
                element,
                format!(
                    "the {what} {} is defined twice, expected each name once",
                    quote(name)
                ),
            );
        }
    }
    names
}
