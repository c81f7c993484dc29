//! Rules for the root attributes, log categories, interface types and default experiment.

use fmu_description::words::is_identifier;
use fmu_description::xml::Element;
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::text::quote;

use super::definitions::unique;
use crate::finding::{Findings, find, require};
use crate::package::{INTERFACES, interfaces};
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

pub fn check(model: &ModelDescription<'_>, findings: &mut Findings) {
    let root = model.root;
    let token = match model.version {
        FmiVersion::Fmi2 => "guid",
        FmiVersion::Fmi3 => "instantiationToken",
    };
    for name in ["modelName", token] {
        let is_given = root
            .attribute(name)
            .is_none_or(|text| !text.trim().is_empty());
        require!(findings, NAME_AND_GUID at root, is_given, "{name} is empty, expected a string");
    }
    if let Some(date) = root.attribute("generationDateAndTime") {
        require!(findings, UTC at root, date.trim().ends_with('Z'),
            "generationDateAndTime is {}, expected a time in UTC, which ends in Z", quote(date));
    }
    unique(
        root.list("LogCategories", "Category"),
        "log category",
        findings,
    );
    unique(root.list("VendorAnnotations", "Tool"), "tool", findings);
    match model.version {
        FmiVersion::Fmi2 => interfaces_2(root, findings),
        FmiVersion::Fmi3 => {
            require!(findings, INTERFACE_GIVEN at root, interfaces(root).next().is_some(),
                "it has no interface type, expected ModelExchange, CoSimulation or \
                 ScheduledExecution");
        }
    }
    for interface in interfaces(root) {
        claims(interface, model.version, findings);
    }
    if let Some(element) = root.child("DefaultExperiment") {
        experiment(element, findings);
    }
}

/// What the schema of FMI 3.0 requires, but not that of FMI 2.0.
fn interfaces_2(root: &Element<'_>, findings: &mut Findings) {
    for kind in INTERFACES {
        if let Some(second) = root.children(kind).nth(1) {
            find!(findings, KIND_ONCE at second, "{kind} appears twice, expected it once");
        }
    }
    let is_exchange = root.child("ModelExchange").is_some();
    require!(findings, EVENT_INDICATORS at root, !is_exchange || root.has("numberOfEventIndicators"),
        "numberOfEventIndicators is missing, expected it for model exchange");
}

/// Checks the attributes of an interface type.
fn claims(interface: &Element<'_>, version: FmiVersion, findings: &mut Findings) {
    if let Some(identifier) = interface.attribute("modelIdentifier") {
        require!(findings, MODEL_IDENTIFIER at interface, is_identifier(identifier),
            "modelIdentifier is {}, expected a C identifier", quote(identifier));
    }
    let state = match version {
        FmiVersion::Fmi2 => ["canSerializeFMUstate", "canGetAndSetFMUstate"],
        FmiVersion::Fmi3 => ["canSerializeFMUState", "canGetAndSetFMUState"],
    };
    let early = [
        "canReturnEarlyAfterIntermediateUpdate",
        "providesIntermediateUpdate",
    ];
    for (rule, [flag, needed]) in [(&SERIALIZE_NEEDS_GET, state), (&EARLY_RETURN, early)] {
        if interface.is_true(flag) && !interface.is_true(needed) {
            let text = format!("{flag} is true, expected {needed} to be true with it");
            findings.add(rule, interface, text);
        }
    }
    let step = interface.real("fixedInternalStepSize").unwrap_or(1.0);
    require!(findings, INTERNAL_STEP at interface, step > 0.0 && step.is_finite(),
        "fixedInternalStepSize is {step}, expected a positive number");
}

fn experiment(element: &Element<'_>, findings: &mut Findings) {
    for (name, above, expected) in [
        ("startTime", f64::NEG_INFINITY, "a finite number"),
        ("stopTime", f64::NEG_INFINITY, "a finite number"),
        ("tolerance", 0.0, "a positive number"),
        ("stepSize", 0.0, "a positive number"),
    ] {
        let value = element.real(name).unwrap_or(1.0);
        require!(findings, EXPERIMENT_NUMBERS at element, value.is_finite() && value > above,
            "{name} is {value}, expected {expected}");
    }
    let start = element.real("startTime").unwrap_or(0.0);
    if let Some(stop) = element.real("stopTime") {
        let (span, step) = (stop - start, element.real("stepSize").unwrap_or(0.0));
        require!(findings, STOP_AFTER_START at element, stop > start,
            "stopTime is {stop}, expected it after startTime {start}");
        require!(findings, STEP_IN_EXPERIMENT at element, span <= 0.0 || step <= span * (1.0 + 1e-9),
            "stepSize is {step}, expected at most stopTime - startTime = {span}");
    }
}
