//! Texts of messages, and the names that FMI allows, for all that check variables.

/// Whether a text is a C identifier, as the name of a model must be.
pub fn is_identifier(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// The bounds of a Real in words, to be put after a noun: ` from 0 to 1`, ` of at least 0`; empty if it
/// has none, which infinities stand for.
pub fn bounds(min: f64, max: f64) -> String {
    match (min.is_finite(), max.is_finite()) {
        (true, true) => format!(" from {min} to {max}"),
        (true, false) => format!(" of at least {min}"),
        (false, true) => format!(" of at most {max}"),
        (false, false) => String::new(),
    }
}

/// A unit to be put after a noun: ` [rad]`; empty if there is none.
pub fn in_unit(unit: &str) -> String {
    match unit.is_empty() {
        true => String::new(),
        false => format!(" [{unit}]"),
    }
}
