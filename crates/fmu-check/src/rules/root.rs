//! Rules for the root attributes, log categories, interface types and default experiment.

use fmu_description::words::is_identifier;
use fmu_description::xml::Element;
use fmu_description::{Capability, ModelDescription};
use fmu_file::text::quote;

use super::unique;
use crate::finding::Findings;
use crate::package::KINDS;

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    let root = model.root;
    for name in ["modelName", "guid"] {
        if root
            .attribute(name)
            .is_some_and(|text| text.trim().is_empty())
        {
            findings.error(root, format!("{name} is empty, expected a string"));
        }
    }
    if let Some(date) = root.attribute("generationDateAndTime")
        && !date.trim().ends_with('Z')
    {
        findings.warning(
            root,
            format!(
                "generationDateAndTime is {}, expected a time in UTC, which ends in Z",
                quote(date)
            ),
        );
    }
    unique(
        root.list("LogCategories", "Category"),
        "log category",
        findings,
    );
    kinds(root, findings);
    experiment(model, findings);
}

fn kinds(root: &Element<'_>, findings: &mut Findings) {
    for kind in KINDS {
        let mut of_kind = root.children(kind);
        if let (Some(_), Some(second)) = (of_kind.next(), of_kind.next()) {
            findings.error(second, format!("{kind} appears twice, expected it once"));
        }
    }
    if root.child("ModelExchange").is_some() && root.attribute("numberOfEventIndicators").is_none()
    {
        findings.warning(
            root,
            "numberOfEventIndicators is missing, expected it for model exchange",
        );
    }
    for kind in root
        .children
        .iter()
        .filter(|child| KINDS.contains(&child.name))
    {
        if let Some(identifier) = kind.attribute("modelIdentifier")
            && !is_identifier(identifier)
        {
            findings.error(
                kind,
                format!(
                    "modelIdentifier is {}, expected a C identifier",
                    quote(identifier)
                ),
            );
        }
        if Capability::CanSerializeFMUstate.is_claimed_by(kind)
            && !Capability::CanGetAndSetFMUstate.is_claimed_by(kind)
        {
            findings.error(
                kind,
                "canSerializeFMUstate is true, expected canGetAndSetFMUstate to be true with it",
            );
        }
    }
}

fn experiment(model: &ModelDescription<'_>, findings: &mut Findings) {
    let Some(element) = model.root.child("DefaultExperiment") else {
        return;
    };
    for name in ["startTime", "stopTime", "tolerance", "stepSize"] {
        if let Some(value) = model.experiment(name) {
            let positive = matches!(name, "tolerance" | "stepSize");
            if !value.is_finite() || (positive && value <= 0.0) {
                let expected = if positive {
                    "a positive number"
                } else {
                    "a finite number"
                };
                findings.error(element, format!("{name} is {value}, expected {expected}"));
            }
        }
    }
    let start = model.experiment("startTime").unwrap_or(0.0);
    if let Some(stop) = model.experiment("stopTime")
        && stop <= start
    {
        findings.error(
            element,
            format!("stopTime is {stop}, expected it after startTime {start}"),
        );
    }
}
