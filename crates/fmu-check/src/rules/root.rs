//! Rules for the root attributes, log categories, interface types and default experiment.

use fmu_description::words::is_identifier;
use fmu_description::xml::Element;
use fmu_description::{Capability, ModelDescription};
use fmu_file::text::quote;

use super::unique;
use crate::finding::Findings;
use crate::package::KINDS;
use crate::rule::rules;

rules! {
    /// The FMU as a whole.
    pub ROOT {
        FMI_VERSION: Error, "fmi-version", Standard("section 2.2.1"),
            "The FMU is of FMI version 2.0; nothing else is checked of another version.";
        NAME_AND_GUID: Error, "name-and-guid", Standard("section 2.2.1"),
            "modelName and guid are not empty.";
        UTC: Warning, "generation-utc", Standard("section 2.2.1"),
            "generationDateAndTime is in UTC.";
        KIND_ONCE: Error, "interface-once", Standard("section 2.2.1"),
            "ModelExchange and CoSimulation appear at most once each.";
        EVENT_INDICATORS: Warning, "event-indicators",
            Practice("importers have to assume that there are none"),
            "An FMU for model exchange declares numberOfEventIndicators.";
        MODEL_IDENTIFIER: Error, "model-identifier", Standard("sections 3.3.1 and 4.3.1"),
            "modelIdentifier is an identifier of C.";
        SERIALIZE_NEEDS_GET: Error, "serialize-needs-get", Standard("sections 3.3.1 and 4.3.1"),
            "An FMU that can serialize its state can get and set it.";
        EXPERIMENT_NUMBERS: Error, "experiment-numbers", Standard("section 2.2.5"),
            "The times of the default experiment are finite, its tolerance and step size positive.";
        STOP_AFTER_START: Error, "stop-after-start", Standard("section 2.2.5"),
            "The default experiment stops after it starts.";
        STEP_IN_EXPERIMENT: Warning, "step-in-experiment", Practice("VDMCheck2 requires it"),
            "The step size of the default experiment is not larger than its duration.";
    }
}

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    let root = model.root;
    for name in ["modelName", "guid"] {
        if root
            .attribute(name)
            .is_some_and(|text| text.trim().is_empty())
        {
            findings.add(
                &NAME_AND_GUID,
                root,
                format!("{name} is empty, expected a string"),
            );
        }
    }
    if let Some(date) = root.attribute("generationDateAndTime")
        && !date.trim().ends_with('Z')
    {
        findings.add(
            &UTC,
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
    unique(root.list("VendorAnnotations", "Tool"), "tool", findings);
    kinds(root, findings);
    experiment(model, findings);
}

fn kinds(root: &Element<'_>, findings: &mut Findings) {
    for kind in KINDS {
        let mut of_kind = root.children(kind);
        if let (Some(_), Some(second)) = (of_kind.next(), of_kind.next()) {
            findings.add(
                &KIND_ONCE,
                second,
                format!("{kind} appears twice, expected it once"),
            );
        }
    }
    if root.child("ModelExchange").is_some() && root.attribute("numberOfEventIndicators").is_none()
    {
        findings.add(
            &EVENT_INDICATORS,
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
            findings.add(
                &MODEL_IDENTIFIER,
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
            findings.add(
                &SERIALIZE_NEEDS_GET,
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
                findings.add(
                    &EXPERIMENT_NUMBERS,
                    element,
                    format!("{name} is {value}, expected {expected}"),
                );
            }
        }
    }
    let start = model.experiment("startTime").unwrap_or(0.0);
    if let Some(stop) = model.experiment("stopTime")
        && stop <= start
    {
        findings.add(
            &STOP_AFTER_START,
            element,
            format!("stopTime is {stop}, expected it after startTime {start}"),
        );
    }
    if let (Some(stop), Some(step)) = (model.experiment("stopTime"), model.experiment("stepSize"))
        && stop > start
        && step > (stop - start) * (1.0 + 1e-9)
    {
        let text = format!(
            "stepSize is {step}, expected at most stopTime - startTime = {}",
            stop - start
        );
        findings.add(&STEP_IN_EXPERIMENT, element, text);
    }
}
