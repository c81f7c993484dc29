//! The human-readable table of a model's variables.

use fmu_description::value::whole;
use fmu_description::{ClockType, ModelDescription, XmlVariable};

/// The column headings.
pub const HEAD: [&str; 8] =
    ["variable", "causality", "variability", "type", "unit", "start", "range", "description"];

/// The cells of a variable.
pub type VariableCells = [String; HEAD.len()];

/// The rows of all variables and their aliases, in the order of the model description.
pub fn rows(model: &ModelDescription<'_>) -> impl Iterator<Item = VariableCells> {
    let variables = model.variables();
    variables.flat_map(|(_, variable)| {
        let row = row(variable, model);
        let alias = |name: &str| {
            let mut alias = row.clone();
            alias[0] = name.to_owned();
            alias[5] = String::new();
            alias[7] = format!("alias of {}", variable.name);
            alias
        };
        let aliases: Vec<_> = variable.aliases.iter().map(|name| alias(name)).collect();
        [row].into_iter().chain(aliases)
    })
}

fn row(v: &XmlVariable<'_>, model: &ModelDescription<'_>) -> VariableCells {
    let item = |start| {
        let mut items = v.items().iter();
        let found = items.find(|item| whole(start) == Some(item.value));
        found.map_or(start, |item| &item.name)
    };
    let starts: Vec<_> = v.starts().into_iter().map(item).collect();
    let sizes = v.element.children("Dimension").map(|dimension| {
        let parameter = model.referred(dimension, "valueReference");
        let parameter = parameter.map(|parameter| parameter.name.as_str());
        dimension.attribute("start").or(parameter).unwrap_or("?")
    });
    let sizes: Vec<_> = sizes.collect();
    let of_type = match sizes.len() {
        0 => v.of_type.name(model.version).to_owned(),
        _ => format!("{}[{}]", v.of_type.as_str(), sizes.join(", ")),
    };
    let clocks = v.clocks.iter().filter_map(|clock| model.variable(model.index(*clock)));
    let clocks = Vec::from_iter(clocks.map(|clock| clock.name.as_str()));
    let variability = match clocks.len() {
        0 => v.variability.as_str().to_owned(),
        _ => format!("{} at {}", v.variability.as_str(), clocks.join(", ")),
    };
    let bound = |name| v.inherited(name).map(short);
    let range = match (bound("min"), bound("max")) {
        _ if v.clock.is_some() => v.clock.as_ref().map(ticks).unwrap_or_default(),
        (Some(min), Some(max)) => format!("{min} to {max}"),
        (Some(min), None) => format!("from {min}"),
        (None, Some(max)) => format!("to {max}"),
        (None, None) => String::new(),
    };
    [
        &v.name,
        v.causality.as_str(),
        &variability,
        &of_type,
        v.unit.as_deref().unwrap_or_default(),
        &starts.join(" "),
        &range,
        &v.description,
    ]
    .map(str::to_owned)
}

/// When a clock ticks, in words.
fn ticks(clock: &ClockType) -> String {
    let interval = clock.interval.map(|interval| format!(" every {interval} s"));
    let shift = Some(clock.shift).filter(|shift| *shift != 0.0);
    let shift = shift.map(|shift| format!(" from {shift} s"));
    let priority = clock.priority.map(|priority| format!(", priority {priority}"));
    let parts = [interval, shift, priority].into_iter().flatten().collect::<String>();
    format!("{}{parts}", clock.interval_variability.as_str())
}

/// A number in scientific notation if that is shorter and the same number.
fn short(number: &str) -> String {
    let Ok(value) = number.parse::<f64>() else { return number.to_owned() };
    let is_rounded = number.parse().is_ok_and(|whole: i128| whole != value as i128);
    let short = format!("{value:e}");
    if number.len() > 5.max(short.len()) && !is_rounded { short } else { number.to_owned() }
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
            ("10000000000000001", "10000000000000001"),
            ("x", "x"),
        ] {
            assert_eq!(short(number), expected);
        }
    }
}
