//! The human-readable table of a model's variables.

use fmu_description::value::integer;
use fmu_description::{ModelDescription, ScalarVariable};

/// The column headings.
pub const HEAD: [&str; 8] = [
    "variable",
    "causality",
    "variability",
    "type",
    "unit",
    "start",
    "range",
    "description",
];

/// The cells of a variable.
pub type Row = [String; HEAD.len()];

/// The rows of all variables, in the order of the model description.
pub fn rows(model: &ModelDescription<'_>) -> impl Iterator<Item = Row> {
    model.variables().map(|(_, variable)| row(variable))
}

fn row(v: &ScalarVariable<'_>) -> Row {
    let start = v.start().unwrap_or_default();
    let item = v.items().find(|(_, value)| integer(start) == Some(*value));
    let bound = |name| v.inherited(name).map(short);
    let range = match (bound("min"), bound("max")) {
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (Some(min), None) => format!("from {min}"),
        (None, Some(max)) => format!("to {max}"),
        (None, None) => String::new(),
    };
    [
        v.name,
        v.causality.as_str(),
        v.variability.as_str(),
        v.kind.as_str(),
        v.unit().unwrap_or_default(),
        item.map_or(start, |(name, _)| name),
        &range,
        v.element.attribute("description").unwrap_or_default(),
    ]
    .map(str::to_owned)
}

/// A number in scientific notation if that is shorter.
fn short(number: &str) -> String {
    match number.parse::<f64>() {
        Ok(value) if number.len() > 5 && format!("{value:e}").len() < number.len() => {
            format!("{value:e}")
        }
        _ => number.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_use_scientific_notation() {
        for (number, expected) in [
            ("1000000000", "1e9"),
            ("-1000000000", "-1e9"),
            ("0.000001", "1e-6"),
            ("0.001", "0.001"),
            ("1000", "1000"),
            ("2147483647", "2147483647"),
            ("x", "x"),
        ] {
            assert_eq!(short(number), expected);
        }
    }
}
