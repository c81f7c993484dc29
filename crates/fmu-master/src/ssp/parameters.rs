//! Parameter values and their mappings.

use std::collections::HashMap;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::value;
use fmu_description::xml::Element;

use super::arrays;
use super::document::document;
use super::system::{ConnectorPath, DefinedUnit, FlatSystem, IncomingConnection, Passage, join};
use super::vocabulary::{self, MAPPING, PARAMETER_SET};
use crate::declarations::units;
use crate::{Conversion, Literal};

impl FlatSystem<'_> {
    /// Sets the values of a binding.
    pub fn bind(&mut self, binding: &Element<'_>, path: &str) -> Result<()> {
        let (mut set_text, mut mapping_text) = (String::new(), String::new());
        let inline = binding.child(vocabulary::VALUES);
        let set = self.part(binding, inline, PARAMETER_SET, &mut set_text)?;
        let entries = binding.child(vocabulary::MAPPING_OF_BINDING).map(|holder| {
            let mapping = self.part(holder, Some(holder), MAPPING, &mut mapping_text)?;
            mapping.children(vocabulary::MAPPING_ENTRY).map(entry).collect()
        });
        let entries: Option<Vec<(String, IncomingConnection)>> = entries.transpose()?;
        // By their sources.
        let entries = entries.map(|entries| {
            let mut targets: HashMap<String, Vec<(String, IncomingConnection)>> = HashMap::new();
            for (target, link) in entries {
                targets.entry(link.from.name.clone()).or_default().push((target, link));
            }
            targets
        });
        let own =
            units(set.list(vocabulary::UNITS_OF_SET, vocabulary::UNIT), vocabulary::BASE_UNIT);
        for parameter in set.list(vocabulary::PARAMETERS, vocabulary::PARAMETER) {
            let name = parameter.attribute("name").unwrap_or_default();
            let (value, unit) = read(parameter).with_context(|| format!("parameter {name}"))?;
            let name = format!("{}{name}", binding.attribute("prefix").unwrap_or_default());
            let unit = self.stated_unit(unit, &own, &name);
            let from = ConnectorPath::new("", &name);
            let unmapped =
                [(name.clone(), IncomingConnection { from, ..IncomingConnection::default() })];
            // A mapping leaves out all that it does not name.
            let targets = match &entries {
                Some(entries) => entries.get(&name).map(Vec::as_slice).unwrap_or_default(),
                None => &unmapped,
            };
            if targets.is_empty() {
                let name = join(path, &name);
                self.warnings.push(format!("the mapping leaves out the parameter {name}"));
            }
            for (target, link) in targets {
                self.set(path, target, link, &value, unit.as_ref())
                    .with_context(|| format!("parameter {name}"))?;
            }
        }
        Ok(())
    }

    /// The parameter set of a binding, or the mapping: in a file, or inline.
    fn part<'b>(
        &mut self,
        holder: &'b Element<'_>,
        inline: Option<&'b Element<'_>>,
        name: &str,
        text: &'b mut String,
    ) -> Result<Element<'b>> {
        let of_type = holder.attribute("type").unwrap_or("application/x-ssp-parameter-");
        let base = holder.attribute("sourceBase").unwrap_or("SSD");
        ensure!(
            of_type.starts_with("application/x-ssp-parameter-"),
            "the type {of_type:?} of parameters is not supported"
        );
        ensure!(base == "SSD", "the sourceBase {base:?} is not supported, expected SSD");
        match holder.attribute("source") {
            Some(source) => {
                *text = self.text(source)?;
                document(text, name).with_context(|| source.to_owned())
            }
            None => {
                let found = inline.and_then(|inline| inline.child(name));
                found.cloned().with_context(|| format!("expected a source, or {name}"))
            }
        }
    }

    /// Sets the variables of a name in the element `path`.
    fn set(
        &mut self,
        path: &str,
        target: &str,
        link: &IncomingConnection,
        value: &Literal,
        unit: Option<&DefinedUnit>,
    ) -> Result<()> {
        let passage = Passage { unit: unit.cloned(), conversion: None };
        let Some(port) = self.find_target(path, target) else {
            let target = join(path, target);
            self.warnings.push(format!("the parameter {target} has no variable, and is ignored"));
            return Ok(());
        };
        // Each element of a connector of a system has its own targets.
        let parts = match self.is_component(&port.element) {
            true => vec![(port.name, value.clone())],
            false => elements(value, &port.name),
        };
        for (name, value) in parts {
            let port = ConnectorPath::new(&port.element, name);
            let mut targets = Vec::new();
            self.follow(passage.clone(), link, &port, &mut targets)?;
            for (ConnectorPath { element, name }, conversion) in targets {
                let value =
                    converted(&value, conversion).context("only a Real can be transformed")?;
                if let Some(Some(index)) = self.elements.get(&element) {
                    let start = &mut self.components[*index].start;
                    if value.is_array() {
                        // Elements that an inner binding has set.
                        let begin = format!("{name}[");
                        let elements = start.range(begin.clone()..).map(|(other, _)| other.clone());
                        let elements = elements.take_while(|other| other.starts_with(&begin));
                        for element in Vec::from_iter(elements) {
                            start.remove(&element);
                        }
                    }
                    start.insert(name, value);
                }
            }
        }
        Ok(())
    }

    /// The variable of a component, or the connector of a system, with this name in the element `path` or in one
    /// of its elements.
    fn find_target(&self, path: &str, name: &str) -> Option<ConnectorPath> {
        let port = ConnectorPath::new(path, name);
        if self.is_component(path) {
            let array = name.split('[').next().unwrap_or_default();
            let is_known = self.model(path).is_none_or(|model| {
                [name, array].iter().any(|name| model.variables.contains_key(*name))
            });
            return is_known.then_some(port);
        }
        if self.has_connector(&port) {
            return Some(port);
        }
        let mut splits = name.match_indices('.').map(|(at, _)| name.split_at(at));
        splits.find_map(|(head, rest)| {
            let path = join(path, head);
            self.elements.contains_key(&path).then(|| self.find_target(&path, &rest[1..]))?
        })
    }
}

/// An entry of a mapping: the name of its target, and a link from its source.
fn entry(element: &Element<'_>) -> Result<(String, IncomingConnection)> {
    let attribute = |name| element.attribute(name).unwrap_or_default().to_owned();
    let source = attribute("source");
    let link = IncomingConnection::new(ConnectorPath::new("", &source), element);
    Ok((attribute("target"), link.with_context(|| format!("mapping of {source}"))?))
}

/// The value of a parameter, and its unit.
pub fn read<'a>(parameter: &'a Element<'_>) -> Result<(Literal, Option<&'a str>)> {
    let found = parameter.children.iter().find_map(|child| Some((child, parser(child.name)?)));
    let Some((element, parse)) = found else {
        let other = parameter.children.first().map_or("nothing", |other| other.name);
        bail!("{other} is not supported, expected a number, Boolean, String or Enumeration");
    };
    let dimensions = arrays::dimensions(parameter)?;
    let dimensions: Option<Vec<usize>> = dimensions.into_iter().collect();
    let dimensions = dimensions.context("a Dimension has no size")?;
    let text = element.attribute("value").unwrap_or_default();
    let listed = Vec::from_iter(element.children(vocabulary::ELEMENT_VALUE));
    let is_text = TEXT_VALUES.contains(&element.name);
    let texts = match () {
        () if !listed.is_empty() => {
            listed.iter().map(|element| element.attribute("value").unwrap_or_default()).collect()
        }
        () if dimensions.is_empty() || is_text => vec![text],
        () => Vec::from_iter(text.split_ascii_whitespace()),
    };
    let count = arrays::count(&dimensions)?;
    ensure!(
        texts.len() == count,
        "the number of values is {}, expected {}",
        texts.len(),
        match dimensions.is_empty() {
            true => "one, as there is no Dimension".to_owned(),
            false => arrays::shown(&Vec::from_iter(dimensions.iter().copied().map(Some))),
        }
    );
    let value = |text: &str| {
        parse(text).with_context(|| format!("{text:?} is not of the type {}", element.name))
    };
    let values = texts.into_iter().map(value).collect::<Result<_>>()?;
    Ok((shaped(values, &dimensions), element.attribute("unit")))
}

/// The types of parameters whose arrays have an element for each value.
const TEXT_VALUES: [&str; 2] = [vocabulary::STRING_VALUE, vocabulary::ENUMERATION_VALUE];

/// How a value of a type is read.
fn parser(of_type: &str) -> Option<fn(&str) -> Option<Literal>> {
    match of_type {
        vocabulary::BOOLEAN_VALUE => Some(|text| value::boolean(text).map(Literal::Boolean)),
        real if vocabulary::REAL_VALUES.contains(&real) => {
            Some(|text| value::real(text).map(Literal::Real))
        }
        whole if vocabulary::WHOLE_VALUES.contains(&whole) => {
            Some(|text| value::whole(text).map(Literal::Integer))
        }
        vocabulary::BINARY_VALUE => Some(|text| value::bytes(text).map(Literal::Bytes)),
        text if TEXT_VALUES.contains(&text) => Some(|text| Some(Literal::Text(text.to_owned()))),
        _ => None,
    }
}

/// The values of a scalar, or of an array row by row, as nested arrays.
fn shaped(mut values: Vec<Literal>, dimensions: &[usize]) -> Literal {
    let Some((_, inner)) = dimensions.split_first() else { return values.swap_remove(0) };
    for length in inner.iter().rev() {
        values = values.chunks(*length).map(|row| Literal::Array(row.to_vec())).collect();
    }
    Literal::Array(values)
}

/// A value after a conversion; `None` if it has other values than real numbers.
pub fn converted(value: &Literal, conversion: Option<Conversion>) -> Option<Literal> {
    match (value, conversion) {
        (value, None) => Some(value.clone()),
        (Literal::Real(value), Some(conversion)) => Some(Literal::Real(conversion.apply(*value))),
        (Literal::Array(values), _) => {
            let values = values.iter().map(|value| converted(value, conversion));
            values.collect::<Option<_>>().map(Literal::Array)
        }
        _ => None,
    }
}

/// The values of an array by the names of its elements, or of a scalar.
fn elements(value: &Literal, name: &str) -> Vec<(String, Literal)> {
    let (mut dimensions, mut values) = (Vec::new(), vec![value.clone()]);
    while let Some(Literal::Array(row)) = values.first() {
        dimensions.push(row.len());
        let rows = values.into_iter();
        values = rows.flat_map(|v| if let Literal::Array(v) = v { v } else { vec![v] }).collect();
    }
    arrays::element_names(name, &dimensions).into_iter().zip(values).collect()
}
