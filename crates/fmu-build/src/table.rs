//! The human-readable table of a model's variables.

use fmu_description::value::whole;
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
    let item = |start| {
        let mut items = v.items();
        let found = items.find(|(_, value)| whole(start) == Some(*value));
        found.map_or(start, |(name, _)| name)
    };
    let starts: Vec<_> = v.starts().into_iter().map(item).collect();
    let sizes: Vec<_> = v.dimensions.iter().map(usize::to_string).collect();
    let of_type = match sizes.len() {
        0 => v.kind.as_str().to_owned(),
        _ => format!("{}[{}]", v.kind.as_str(), sizes.join(",")),
    };
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
        &of_type,
        v.unit().unwrap_or_default(),
        &starts.join(" "),
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
