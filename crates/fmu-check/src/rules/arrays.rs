//! What FMI 3.0 adds to variables: arrays, structural parameters and Binaries.

use fmu_description::value::{items, whole};
use fmu_description::xml::Element;
use fmu_description::{Causality, Type, Variability, XmlVariable};

use super::Check;
use crate::finding::{find, require};

impl Check<'_> {
    /// Checks the number of bytes of the start values of a Binary.
    pub(super) fn start_size(&mut self, variable: &XmlVariable<'_>) {
        let max = variable.inherited("maxSize").and_then(whole);
        let max = max.unwrap_or(u32::MAX);
        for start in variable.element.children("Start") {
            // Two digits a byte.
            let size = start.attribute("value").unwrap_or_default().trim().len() / 2;
            require!(self, "start-size" at variable, size <= max as usize,
                "its start value has {size} bytes, expected at most maxSize = {max}");
        }
    }

    /// Checks the dimensions of a variable, and how many start values it has.
    pub(super) fn elements(&mut self, variable: &XmlVariable<'_>) {
        let element = variable.element;
        if variable.causality == Causality::StructuralParameter
            && let Some(dimension) = element.child("Dimension")
        {
            find!(self, "structural-scalar" at dimension,
                "the structural parameter has a Dimension, expected none");
        }
        let mut size = Some(1_u64);
        for dimension in element.children("Dimension") {
            let pair = size.zip(self.length(dimension));
            size = pair.and_then(|(a, b)| a.checked_mul(b));
            require!(self, "array-size" at variable, pair.is_none() || size.is_some(),
                "its dimensions have more elements than a computer can address");
        }
        let is_list = matches!(variable.of_type, Type::String | Type::Binary);
        let starts = match is_list {
            true => element.children("Start").count(),
            false => element.attribute("start").map_or(1, |start| items(start).count()),
        };
        if let Some(size) = size {
            let fits = starts == 1 || starts as u64 == size || is_list && starts == 0;
            let or_more = match size {
                1 => String::new(),
                size => format!(" or {size}"),
            };
            require!(self, "start-count" at variable, fits,
                "it has {starts} start values, expected 1{or_more}");
        }
    }

    /// The initial size of a dimension, if it is valid.
    fn length(&mut self, dimension: &Element<'_>) -> Option<u64> {
        let is_size = |v: &&XmlVariable<'_>| {
            let is_structural = v.causality == Causality::StructuralParameter;
            v.of_type == Type::UInt64 && (is_structural || v.variability == Variability::Constant)
        };
        let start = match ["start", "valueReference"].map(|name| dimension.attribute(name)) {
            [Some(start), None] => start,
            [None, Some(reference)] => {
                let referred = self.model.referred(dimension, "valueReference");
                let Some(size) = referred.filter(is_size) else {
                    find!(self, "dimension-reference" at dimension,
                        "valueReference of the Dimension is {reference}, expected that of a UInt64 that \
                         is a constant or a structural parameter");
                    return None;
                };
                size.start()?
            }
            [start, _] => {
                let both = match start {
                    Some(_) => "both start and",
                    None => "neither start nor",
                };
                find!(self, "dimension-size" at dimension,
                    "the Dimension has {both} valueReference, expected one of them");
                return None;
            }
        };
        let length = whole(start)?;
        require!(self, "dimension-positive" at dimension, length > 0,
            "the initial size of the Dimension is 0, expected a positive number");
        Some(length)
    }
}
