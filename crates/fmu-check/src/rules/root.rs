//! Rules for the root attributes, log categories, interface types and default experiment.

use fmu_description::FmiVersion;
use fmu_description::value::{boolean, real};
use fmu_description::words::is_identifier;
use fmu_description::xml::Element;
use fmu_file::text::quote;

use super::{Model, unique};
use crate::finding::Findings;
use crate::package::INTERFACES;
use crate::package::interfaces;
use crate::rule::rules;

rules! {
    /// The FMU as a whole.
    pub ROOT {
        FMI_VERSION: Error, "fmi-version", Standard("section 2.2.1", "section 2.4.1"),
            "The FMU is of FMI version 2.0 or 3.0; nothing else is checked of another version.";
        NAME_AND_GUID: Error, "name-and-guid", Standard("section 2.2.1", "section 2.4.1"),
            "modelName and guid, in FMI 3.0 instantiationToken, are not empty.";
        UTC: Warning, "generation-utc", Standard("section 2.2.1", "section 2.4.1"),
            "generationDateAndTime is in UTC.";
        KIND_ONCE: Error, "interface-once", Fmi2("section 2.2.1"),
            "ModelExchange and CoSimulation appear at most once each.";
        INTERFACE_GIVEN: Error, "interface-given", Fmi3("section 2.4.1"),
            "There is an interface type: ModelExchange, CoSimulation or ScheduledExecution.";
        EVENT_INDICATORS: Warning, "event-indicators",
            Practice("importers have to assume that there are none"),
            "An FMU for model exchange declares numberOfEventIndicators.";
        MODEL_IDENTIFIER: Error, "model-identifier", Standard("sections 3.3.1 and 4.3.1", "section 2.4.2"),
            "modelIdentifier is an identifier of C.";
        SERIALIZE_NEEDS_GET: Error, "serialize-needs-get", Standard("sections 3.3.1 and 4.3.1", "section 2.4.2"),
            "An FMU that can serialize its state can get and set it.";
        EARLY_RETURN: Error, "early-return", Fmi3("section 4.4"),
            "An FMU that can return early after an intermediate update provides these updates.";
        INTERNAL_STEP: Error, "internal-step", Fmi3("section 4.4"),
            "fixedInternalStepSize is a positive number.";
        EXPERIMENT_NUMBERS: Error, "experiment-numbers", Standard("section 2.2.5", "section 2.4.6"),
            "The times of the default experiment are finite, its tolerance and step size positive.";
        STOP_AFTER_START: Error, "stop-after-start", Standard("section 2.2.5", "section 2.4.6"),
            "The default experiment stops after it starts.";
        STEP_IN_EXPERIMENT: Warning, "step-in-experiment", Practice("VDMCheck2 requires it"),
            "The step size of the default experiment is not larger than its duration.";
    }
}

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    let root = model.root;
    let token = match model.version {
        FmiVersion::Fmi2 => "guid",
        FmiVersion::Fmi3 => "instantiationToken",
    };
    for name in ["modelName", token] {
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
    kinds(root, model.version, findings);
    experiment(model, findings);
}

fn kinds(root: &Element<'_>, version: FmiVersion, findings: &mut Findings) {
    // The schema of FMI 3.0 has this rule.
    for kind in INTERFACES
        .into_iter()
        .filter(|_| version == FmiVersion::Fmi2)
    {
        if let Some(second) = root.children(kind).nth(1) {
            findings.add(
                &KIND_ONCE,
                second,
                format!("{kind} appears twice, expected it once"),
            );
        }
    }
    if interfaces(root).next().is_none() && version == FmiVersion::Fmi3 {
        let text =
            "it has no interface type, expected ModelExchange, CoSimulation or ScheduledExecution";
        findings.add(&INTERFACE_GIVEN, root, text);
    }
    if version == FmiVersion::Fmi2
        && root.child("ModelExchange").is_some()
        && root.attribute("numberOfEventIndicators").is_none()
    {
        findings.add(
            &EVENT_INDICATORS,
            root,
            "numberOfEventIndicators is missing, expected it for model exchange",
        );
    }
    let (serialize, get) = match version {
        FmiVersion::Fmi2 => ("canSerializeFMUstate", "canGetAndSetFMUstate"),
        FmiVersion::Fmi3 => ("canSerializeFMUState", "canGetAndSetFMUState"),
    };
    for kind in interfaces(root) {
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
        let claims = |name| kind.attribute(name).and_then(boolean) == Some(true);
        if claims(serialize) && !claims(get) {
            let text = format!("{serialize} is true, expected {get} to be true with it");
            findings.add(&SERIALIZE_NEEDS_GET, kind, text);
        }
        if claims("canReturnEarlyAfterIntermediateUpdate") && !claims("providesIntermediateUpdate")
        {
            let text = "canReturnEarlyAfterIntermediateUpdate is true, expected providesIntermediateUpdate to be true with it";
            findings.add(&EARLY_RETURN, kind, text);
        }
        if let Some(step) = kind.attribute("fixedInternalStepSize").and_then(real)
            && !(step > 0.0 && step.is_finite())
        {
            let text = format!("fixedInternalStepSize is {step}, expected a positive number");
            findings.add(&INTERNAL_STEP, kind, text);
        }
    }
}

fn experiment(model: &Model<'_>, findings: &mut Findings) {
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
