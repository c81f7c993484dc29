//! What `cargo fmu info` shows of clocks, of the variables that change at their ticks, and of Binaries.

use std::collections::HashMap;

use fmu_description::{ClockType, ModelDescription, Type, XmlVariable};
use serde_json::{Value, json};

/// The names of the clocks by their value references.
pub type Clocks<'a> = HashMap<u32, &'a str>;

/// The clocks of a model.
pub fn clocks<'a>(model: &'a ModelDescription<'_>) -> Clocks<'a> {
    let clocks = model.variables().filter(|(_, variable)| variable.of_type == Type::Clock);
    clocks.map(|(_, clock)| (clock.reference, &*clock.name)).collect()
}

/// A line for each clock: when it ticks, and which variables change then.
pub fn clock_lines(model: &ModelDescription<'_>) -> Vec<String> {
    let mut clocked: HashMap<u32, Vec<&str>> = HashMap::new();
    for (_, variable) in model.variables() {
        for clock in &variable.clocks {
            clocked.entry(*clock).or_default().push(&variable.name);
        }
    }
    let line = |clock: &XmlVariable<'_>| {
        let of_type = clock.clock?;
        let clocked = clocked.get(&clock.reference).map(|names| format!(": {}", names.join(", ")));
        let clocked = clocked.unwrap_or_default();
        let causality = clock.causality.as_str();
        Some(format!("  {} ({causality}, {}){clocked}", clock.name, described(&of_type)))
    };
    model.variables().filter_map(|(_, variable)| line(variable)).collect()
}

/// The kind of a clock, and what is known of its ticks.
fn described(clock: &ClockType) -> String {
    let ClockType { interval, shift, priority, .. } = clock;
    let parts = [
        Some(clock.interval_variability.as_str().to_owned()),
        interval.map(|interval| format!("every {interval} s")),
        (*shift != 0.0).then(|| format!("from {shift} s")),
        priority.map(|priority| format!("priority {priority}")),
    ];
    Vec::from_iter(parts.into_iter().flatten()).join(", ")
}

/// A line for each Binary of which the MIME type or the largest size is known.
pub fn binary_lines(model: &ModelDescription<'_>) -> Vec<String> {
    let line = |variable: &XmlVariable<'_>| {
        let size = variable.max_size.map(|size| format!("at most {size} bytes"));
        let parts = Vec::from_iter(variable.mime_type.clone().into_iter().chain(size));
        (!parts.is_empty()).then(|| format!("  {}: {}", variable.name, parts.join(", ")))
    };
    model.variables().filter_map(|(_, variable)| line(variable)).collect()
}

/// What only clocks, clocked variables and Binaries have, by the names of the attributes; `seconds` makes a number.
pub fn attributes(
    variable: &XmlVariable<'_>,
    clocks: &Clocks<'_>,
    seconds: fn(f64) -> Value,
) -> Vec<(&'static str, Value)> {
    let mut all = Vec::new();
    if let Some(clock) = variable.clock {
        all.extend([
            ("intervalVariability", json!(clock.interval_variability.as_str())),
            ("interval", clock.interval.map_or(Value::Null, seconds)),
            ("shift", seconds(clock.shift)),
            ("priority", json!(clock.priority)),
        ]);
    }
    if !variable.clocks.is_empty() {
        let names = variable.clocks.iter().filter_map(|reference| clocks.get(reference));
        all.push(("clocks", json!(Vec::from_iter(names))));
    }
    if variable.of_type == Type::Binary {
        all.push(("mimeType", json!(variable.mime_type)));
        all.push(("maxSize", json!(variable.max_size)));
    }
    all
}
