//! Rules for arrays and structural parameters (FMI 3.0.2, section 2.4.7.2).

use fmu_description::value::{items, unsigned};
use fmu_description::xml::Element;

use super::{Model, Variable};
use crate::finding::{Findings, Location};
use crate::rule::rules;

rules! {
    /// Arrays and structural parameters.
    pub ARRAYS {
        DIMENSION_SIZE: Error, "dimension-size", Fmi3("section 2.4.7.2"),
            "A Dimension has either start or valueReference.";
        DIMENSION_REFERENCE: Error, "dimension-reference", Fmi3("section 2.4.7.2"),
            "valueReference of a Dimension is that of a UInt64, which is a constant or a structural parameter.";
        DIMENSION_POSITIVE: Error, "dimension-positive", Fmi3("section 2.4.7.2"),
            "The initial size of a dimension is not 0.";
        STRUCTURAL_SCALAR: Error, "structural-scalar", Fmi3("section 2.4.7.4"),
            "A structural parameter has no dimensions.";
        START_COUNT: Error, "start-count", Fmi3("section 2.4.7.5"),
            "A variable with start values has one, or one for each of its elements.";
        START_SIZE: Error, "start-size", Fmi3("section 2.4.4"),
            "The start value of a Binary is not longer than maxSize.";
    }
}

pub fn check(model: &Model<'_>, findings: &mut Findings) {
    for (_, variable) in model.variables() {
        start_size(variable, findings);
    }
    for variable in model.elements() {
        if variable.attribute("causality") == Some("structuralParameter")
            && let Some(dimension) = variable.child("Dimension")
        {
            let text = "the structural parameter has a Dimension, expected none";
            findings.add(&STRUCTURAL_SCALAR, dimension, text);
        }
        let mut size = Some(1_u64);
        for dimension in variable.children("Dimension") {
            let length = length(dimension, model, findings);
            size = size.zip(length).and_then(|(a, b)| a.checked_mul(b));
        }
        let starts = match variable.name {
            "String" | "Binary" => variable.children("Start").count(),
            _ => match variable.attribute("start") {
                Some(start) => items(start).count(),
                None => continue,
            },
        };
        let is_list = matches!(variable.name, "String" | "Binary");
        if let Some(size) = size
            && !(is_list && starts == 0)
            && starts != 1
            && starts as u64 != size
        {
            let expected = match size {
                1 => "1".to_owned(),
                _ => format!("1 or {size}"),
            };
            let text = format!("it has {starts} start values, expected {expected}");
            findings.add(&START_COUNT, Location::of_variable(variable), text);
        }
    }
}

/// Checks the number of bytes of the start values of a Binary.
fn start_size(variable: &Variable<'_>, findings: &mut Findings) {
    let Some(max) = variable.inherited("maxSize").and_then(unsigned) else {
        return;
    };
    for start in variable.element.children("Start") {
        // Two digits a byte.
        let size = start.attribute("value").unwrap_or_default().trim().len() / 2;
        if size > max as usize {
            let text =
                format!("its start value has {size} bytes, expected at most maxSize = {max}");
            findings.add(&START_SIZE, variable, text);
        }
    }
}

/// The initial size of a dimension, if it is valid.
fn length(dimension: &Element<'_>, model: &Model<'_>, findings: &mut Findings) -> Option<u64> {
    let (start, reference) = (
        dimension.attribute("start"),
        dimension.attribute("valueReference"),
    );
    if start.is_some() == reference.is_some() {
        let found = match start {
            Some(_) => "both start and valueReference",
            None => "neither start nor valueReference",
        };
        let text = format!("the Dimension has {found}, expected one of them");
        findings.add(&DIMENSION_SIZE, dimension, text);
        return None;
    }
    let start = match reference {
        None => start,
        Some(reference) => {
            let variable = model.referred(dimension, "valueReference");
            let variable = variable.map(|variable| variable.element);
            let is_size = |variable: &&Element<'_>| {
                variable.name == "UInt64"
                    && (variable.attribute("causality") == Some("structuralParameter")
                        || variable.attribute("variability") == Some("constant"))
            };
            let Some(variable) = variable.filter(is_size) else {
                let text = format!(
                    "valueReference of the Dimension is {reference}, expected that of a UInt64 \
                     that is a constant or a structural parameter"
                );
                findings.add(&DIMENSION_REFERENCE, dimension, text);
                return None;
            };
            variable.attribute("start")
        }
    };
    let length = start.and_then(|start| start.trim().parse().ok())?;
    if length == 0 {
        let text = "the initial size of the Dimension is 0, expected a positive number";
        findings.add(&DIMENSION_POSITIVE, dimension, text);
    }
    Some(length)
}
