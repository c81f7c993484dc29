//! The contents of FMUs as JSON, with the names of the standard. Numbers are numbers with all their digits; those that
//! JSON does not have are the texts "inf", "-inf" and "NaN".

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use fmu_description::value::{real, whole};
use fmu_description::xml::{self, Element};
use fmu_description::{ModelDescription, Value as Start, XmlVariable};
use fmu_file::archive::{Archive, TERMINALS};
use serde_json::{Map, Value, json};

use super::{MAX_TERMINALS, MEMBERS, contents, inspect, interface_attributes, signals};

/// Prints an object; of several FMUs, an array of objects.
///
/// # Errors
/// As [`super::run`].
pub fn print(files: &[PathBuf], out: &mut impl Write) -> Result<()> {
    let read = |file: &PathBuf| inspect(file, |model, archive| Ok(fmu(file, model, archive)));
    let mut fmus = files.iter().map(read).collect::<Result<Vec<_>>>()?;
    let shown = match fmus.len() {
        1 => fmus.remove(0),
        _ => Value::Array(fmus),
    };
    Ok(writeln!(out, "{shown:#}")?)
}

fn fmu(file: &Path, model: &ModelDescription<'_>, archive: &mut Archive) -> Value {
    let (common, interfaces) = interface_attributes(model.version);
    let interfaces = interfaces.iter().filter_map(|[name, _, flags, numbers]| {
        let element = model.root.child(name)?;
        let mut object = attributes(element);
        for flag in common.split_whitespace().chain(flags.split_whitespace()) {
            object.insert(flag.into(), element.is_true(flag).into());
        }
        for name in numbers.split_whitespace() {
            numeric(&mut object, name);
        }
        Some(((*name).to_owned(), object.into()))
    });
    let experiment = ["startTime", "stopTime", "stepSize", "tolerance"];
    let experiment =
        experiment.map(|name| (name.to_owned(), model.experiment(name).map(number).into()));
    let enumerations = model.enumerations().map(|of_type| {
        let items = of_type.items.iter().map(|item| (item.name.clone(), item.value.into()));
        (of_type.name, Value::Object(items.collect()))
    });
    let clocks = signals::clocks(model);
    let variables = model.variables().map(|(_, variable)| {
        let mut shown = described(variable);
        for (name, attribute) in signals::attributes(variable, &clocks, number) {
            shown[name] = attribute;
        }
        shown
    });
    let terminals = archive.head(TERMINALS, MAX_TERMINALS);
    let terminals = terminals.map(|bytes| xml::decode(&bytes).text).unwrap_or_default();
    let terminals = xml::parse(&terminals).ok();
    let terminals = terminals.as_ref().and_then(|root| root.child("Terminals")).map(within);
    let mut description = attributes(model.root);
    numeric(&mut description, "numberOfEventIndicators");
    let references = super::references::json(archive);
    let [platforms, documents, resources, sources] = contents(archive);
    let mut shown = json!({
        "file": file.to_string_lossy(),
        "size": archive.size,
        "platforms": platforms,
        "documents": documents,
        "resources": resources,
        "sources": sources,
        "modelDescription": description,
        "defaultExperiment": Map::from_iter(experiment),
        "interfaces": Map::from_iter(interfaces),
        "variables": Vec::from_iter(variables),
        "enumerations": Map::from_iter(enumerations),
        "terminals": terminals.unwrap_or_default(),
    });
    if !references.is_null() {
        shown["references"] = references;
    }
    shown
}

/// The attributes of an element, as written.
fn attributes(element: &Element<'_>) -> Map<String, Value> {
    let attributes = element.attributes.iter();
    attributes.map(|(name, text)| ((*name).to_owned(), json!(text))).collect()
}

fn described(variable: &XmlVariable<'_>) -> Value {
    let starts = Vec::from_iter(variable.start.iter().map(value));
    let start = match starts.as_slice() {
        [] => Value::Null,
        [start] if variable.dimensions.is_empty() => start.clone(),
        _ => Value::Array(starts),
    };
    let of_type = variable.declared_type.as_ref().map(|declared| &declared.name);
    let mut shown = json!({
        "name": variable.name,
        "valueReference": variable.reference,
        "description": variable.description,
        "causality": variable.causality.as_str(),
        "variability": variable.variability.as_str(),
        "initial": variable.initial.map(|initial| initial.as_str()),
        "type": variable.element.name.replace("ScalarVariable", variable.value.name),
        "declaredType": of_type,
        "unit": variable.unit,
        "start": start,
        "min": variable.min.as_ref().map(value),
        "max": variable.max.as_ref().map(value),
        "nominal": variable.inherited("nominal").and_then(real).map(number),
        "dimensions": variable.dimensions,
        "aliases": variable.aliases,
    });
    if !variable.clocks.is_empty() {
        shown["clocks"] = json!(variable.clocks);
    }
    if let Some(clock) = &variable.clock {
        shown["clock"] = json!({
            "intervalVariability": clock.interval_variability.as_str(),
            "interval": clock.interval,
            "shift": clock.shift,
            "resolution": clock.resolution,
            "priority": clock.priority,
        });
    }
    shown
}

/// Replaces the text of an attribute by its number.
fn numeric(attributes: &mut Map<String, Value>, name: &str) {
    if let Some(attribute) = attributes.get_mut(name)
        && let Some(text) = attribute.as_str()
    {
        let parsed = whole::<u64>(text).map(Value::from).or_else(|| real(text).map(number));
        *attribute = parsed.unwrap_or_else(|| attribute.take());
    }
}

/// A number that JSON does not have is a text.
fn number(number: f64) -> Value {
    value(&Start::Float64(number))
}

/// As `number`.
pub fn value(value: &Start) -> Value {
    match (value, value.as_whole(), value.as_real()) {
        (Start::Boolean(value), ..) => json!(value),
        (_, Some(whole), _) => match u64::try_from(whole) {
            Ok(whole) => json!(whole),
            Err(_) => json!(whole as i64),
        },
        (_, _, Some(real)) if real.is_finite() => json!(real),
        _ => json!(value.to_string()),
    }
}

/// The terminals in an element.
fn within(parent: &Element<'_>) -> Value {
    let terminals = parent.children("Terminal").map(|terminal| {
        let mut object = attributes(terminal);
        let is_member =
            |child: &&Element<'_>| MEMBERS.iter().any(|name| child.attribute(name).is_some());
        let members = terminal.children.iter().filter(is_member).map(attributes);
        object.insert("members".into(), json!(Vec::from_iter(members)));
        object.insert("terminals".into(), within(terminal));
        Value::Object(object)
    });
    Value::Array(Vec::from_iter(terminals))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_digits_and_those_that_json_lacks_are_texts() {
        let largest = [Start::UInt64(u64::MAX), Start::Int64(i64::MIN), Start::Enumeration(3)];
        let shown = largest.map(|start| value(&start).to_string());
        assert_eq!(shown, ["18446744073709551615", "-9223372036854775808", "3"]);
        let reals = [0.1 + 0.2, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
        let shown = reals.map(|real| number(real).to_string());
        assert_eq!(shown, ["0.30000000000000004", "\"inf\"", "\"-inf\"", "\"NaN\""]);
        let mut attributes = Map::new();
        for (text, shown) in [("2", "2"), ("1e-3", "0.001"), ("INF", "\"inf\""), ("x", "\"x\"")] {
            attributes.insert("a".into(), text.into());
            numeric(&mut attributes, "a");
            assert_eq!(attributes["a"].to_string(), shown);
        }
    }
}
