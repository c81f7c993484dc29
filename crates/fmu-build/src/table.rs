//! The table of a model's variables, for people.

use std::collections::HashMap;

use fmu_description::schema::{ModelDescription, ScalarVariable, TypeDefinitions};

/// What the columns are.
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
pub fn rows(model: &ModelDescription) -> impl Iterator<Item = Row> {
    let items = items(model.type_definitions.as_ref());
    let variables = model.model_variables.variables.iter();
    variables.map(move |variable| row(variable, &items))
}

/// Names of the items of enumerations, by the names of the types and the values of the items.
type Items<'a> = HashMap<(&'a str, i32), &'a str>;

fn items(types: Option<&TypeDefinitions>) -> Items<'_> {
    let types = types.into_iter().flat_map(|types| &types.types);
    let items = types.flat_map(|defined| {
        let items = defined.enumeration.iter().flat_map(|e| &e.items);
        items.map(|item| ((defined.name.as_str(), item.value), item.name.as_str()))
    });
    items.collect()
}

fn row(v: &ScalarVariable, items: &Items<'_>) -> Row {
    let (kind, value) = v
        .value()
        .map_or(("", None), |(kind, value)| (kind, Some(value)));
    let text = |text: Option<&String>| text.cloned().unwrap_or_default();
    let declared = value.and_then(|value| value.declared_type.as_deref());
    let item = |value: &str| items.get(&(declared?, value.parse().ok()?)).copied();
    let start = text(value.and_then(|value| value.start.as_ref()));
    let bound = |bound: Option<&String>| bound.map(|bound| short(bound));
    let bounds = value.map(|value| (bound(value.min.as_ref()), bound(value.max.as_ref())));
    let range = match bounds {
        Some((Some(min), Some(max))) => format!("{min} to {max}"),
        Some((Some(min), None)) => format!("from {min}"),
        Some((None, Some(max))) => format!("to {max}"),
        _ => String::new(),
    };
    [
        v.name.clone(),
        text(v.causality.as_ref()),
        text(v.variability.as_ref()),
        kind.to_owned(),
        text(value.and_then(|value| value.unit.as_ref())),
        item(&start).map_or(start.clone(), str::to_owned),
        range,
        text(v.description.as_ref()),
    ]
}

/// A number as powers of ten where that is easier to read.
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
    fn long_rows_of_zeros_become_powers_of_ten() {
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
