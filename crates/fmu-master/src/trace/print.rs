//! Prints the calls of a trace with the names of variables.

use std::io::Write;
use std::path::Path;

use anyhow::Result;
use fmu_host::Element;

use super::read::{Trace, TracedCall, TracedComponent};
use super::replay::{place, shown};

/// Prints the calls, one in a line, of all components or one.
///
/// # Errors
/// The trace cannot be read, or has no such component.
pub fn print_calls(trace: &Path, component: Option<&str>, out: &mut impl Write) -> Result<()> {
    let mut trace = Trace::open(trace)?;
    let chosen = component.map(|name| trace.component(name)).transpose()?;
    while let Some(call) = trace.next_call()? {
        if chosen.is_none_or(|chosen| chosen == call.component) {
            writeln!(out, "{}", line(&call, &trace.components[call.component]))?;
        }
    }
    if let Some(ended) = &trace.ended {
        writeln!(out, "the process {ended}")?;
    }
    Ok(())
}

fn line(call: &TracedCall, component: &TracedComponent) -> String {
    let names = Vec::from_iter(component.names(&call.call));
    let mut parts = Vec::new();
    let lists = [&call.call.given, &call.call.returned];
    for (name, elements) in lists.into_iter().flatten() {
        let is_of_variables = elements.len() == names.len() && name == "values";
        match name.as_str() {
            "references" | "n" | "n_values" => {}
            _ if is_of_variables => {
                let pairs = names.iter().zip(elements);
                parts.extend(pairs.map(|(name, value)| format!("{name} = {}", text(value))));
            }
            _ => {
                let values = Vec::from_iter(elements.iter().map(text)).join(" ");
                parts.push(format!("{name} = {values}"));
            }
        }
    }
    let has_values = call.call.given.iter().chain(&call.call.returned).any(|(n, _)| n == "values");
    if !has_values {
        parts.extend(names);
    }
    let end = match (&call.status, &call.ended) {
        (Some(serde_json::Value::Null), _) => String::new(),
        (Some(status), _) => format!(" -> {}", shown(status)),
        (None, Some(ended)) => format!(" -> the process {ended}"),
        (None, None) => " -> did not return".to_owned(),
    };
    let separator = if parts.is_empty() { "" } else { " " };
    let microseconds = call.nanoseconds as f64 / 1e3;
    format!("{}{separator}{}{end} ({microseconds:.1} µs)", place(call, component), parts.join(", "))
}

fn text(element: &Element) -> String {
    match element {
        Element::Integer(value) => value.to_string(),
        Element::Float32(value) => format!("{value:?}"),
        Element::Float64(value) => format!("{value:?}"),
        Element::Text(Some(text)) => format!("{text:?}"),
        Element::Bytes(Some(bytes)) => format!("{} bytes", bytes.len()),
        Element::State(number) if *number != 0 => format!("state {number}"),
        _ => "NULL".to_owned(),
    }
}
