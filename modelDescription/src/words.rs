//! Texts of messages, and the names that FMI allows, for all that check variables.

use std::fmt::Display;

/// Whether a text is a C identifier, as the name of a model must be.
pub fn is_identifier(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// Bounds in words, to be put after a noun: ` from 0 to 1`, ` of at least 0`; empty if there are none.
pub fn bounds<T: Display>(min: Option<T>, max: Option<T>) -> String {
    match (min, max) {
        (Some(min), Some(max)) => format!(" from {min} to {max}"),
        (Some(min), None) => format!(" of at least {min}"),
        (None, Some(max)) => format!(" of at most {max}"),
        (None, None) => String::new(),
    }
}

/// The keywords of the Modelica language (section 2.3.3 of its specification 3.6), and its variable `time`.
const MODELICA: &str = "algorithm and annotation block break class connect connector constant constrainedby der \
    discrete each else elseif elsewhen encapsulated end enumeration equation expandable extends external false final \
    flow for function if import impure in initial inner input loop model not operator or outer output package \
    parameter partial protected public pure record redeclare replaceable return stream then time true type when while \
    within";

/// Whether a tool for Modelica cannot have a variable of this name.
pub fn is_reserved_in_modelica(name: &str) -> bool {
    MODELICA.split_whitespace().any(|word| word == name)
}

/// A name as tools for Modelica write it, with `_` for periods, brackets and the like.
pub fn modelica_name(name: &str) -> String {
    name.replace(|c: char| !c.is_alphanumeric(), "_")
}
