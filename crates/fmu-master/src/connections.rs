//! The connections of a system, resolved and checked: every connection leads from an output to a matching input.

use std::collections::HashSet;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, MimeType, Type};

use crate::components::{Components, LoadedComponent, ScalarId};
use crate::{Connection, Conversion, Description, Fault};

/// A resolved connection.
#[derive(Debug, Clone)]
pub(crate) struct ResolvedConnection {
    pub(crate) from: ScalarId,
    pub(crate) to: ScalarId,
    pub(crate) conversion: Option<Conversion>,
    pub(crate) faults: Vec<Fault>,
}

/// Resolves the connections of a description.
///
/// # Errors
/// A connection does not fit, or one of its faults.
pub(crate) fn resolve(
    description: &Description,
    components: &Components,
) -> Result<Vec<ResolvedConnection>> {
    let connections = description.connections.iter().map(|connection| {
        let Connection { from, to, conversion, faults } = connection;
        let mut all = faults.iter();
        let checked = all.try_for_each(|fault| fault.check(description.step));
        checked.with_context(|| format!("{from} -> {to}"))?;
        let (from, to) = (components.scalar(from)?, components.settable(to)?);
        Ok(ResolvedConnection { from, to, conversion: *conversion, faults: faults.clone() })
    });
    let connections = connections.collect::<Result<Vec<_>>>()?;
    check(components, &connections)?;
    Ok(connections)
}

/// Checks that every connection leads from an output to a matching input, and that no input is connected twice.
fn check(components: &[LoadedComponent], connections: &[ResolvedConnection]) -> Result<()> {
    let mut connected = HashSet::new();
    for ResolvedConnection { from: output, to: input, conversion, faults } in connections {
        for (id, expected) in [(output, Causality::Output), (input, Causality::Input)] {
            let name = id.name(components);
            if let Some(reason) = id.fmu(components).unusable(id.scalar) {
                bail!("{name} cannot be connected: {reason}");
            }
            let actual = id.variable(components).causality;
            let ends = [output, input].map(|id| id.variable(components).causality);
            let [a, b] = [output, input].map(|id| id.name(components));
            let hint = match ends {
                [Causality::Input, Causality::Output] => format!("; did you mean {b} -> {a}?"),
                _ => String::new(),
            };
            ensure!(
                actual == expected,
                "{name} is connected as {}, but is {}{hint}",
                with_article(expected),
                with_article(actual)
            );
        }
        let [a, b] = [output, input].map(|id| id.name(components));
        let [from, to] = [output, input].map(|id| id.variable(components));
        let [from_fmu, to_fmu] = [output, input].map(|id| id.fmu(components));
        ensure!(
            class(from.of_type) == class(to.of_type),
            "{a} ({}) cannot feed {b} ({}): the types differ",
            from.of_type.name(from_fmu.version),
            to.of_type.name(to_fmu.version)
        );
        if let (Some(one), Some(other)) = (&from.mime_type, &to.mime_type) {
            ensure!(
                MimeType::fits(one, other),
                "{a} ({one}) cannot feed {b} ({other}): the MIME types differ"
            );
        }
        ensure!(
            conversion.is_none() || from.of_type.is_float(),
            "{a} cannot feed {b} with a factor: both must be real numbers"
        );
        ensure!(
            faults.is_empty() || from.of_type.is_float(),
            "{a} cannot feed {b} with faults: both must be real numbers"
        );
        if let (Some(one), Some(other), None) = (&from.unit, &to.unit, conversion) {
            ensure!(
                from_fmu.same_unit(one, to_fmu, other),
                "{a} [{one}] cannot feed {b} [{other}]: the units differ; give the connection a factor to convert them"
            );
        }
        ensure!(connected.insert(*input), "{b} is connected twice");
    }
    Ok(())
}

/// The type that stands for all that a variable may feed: numbers of different size are converted.
fn class(kind: Type) -> Type {
    match kind {
        kind if kind.is_float() => Type::Float64,
        kind if kind.is_integer() || kind == Type::Enumeration => Type::Int64,
        other => other,
    }
}

/// A causality with its article, for messages.
pub(crate) fn with_article(causality: Causality) -> &'static str {
    match causality {
        Causality::Input => "an input",
        Causality::Output => "an output",
        Causality::Parameter => "a parameter",
        Causality::CalculatedParameter => "a calculated parameter",
        Causality::Local => "a local variable",
        Causality::Independent => "the time",
        Causality::StructuralParameter => "a structural parameter",
    }
}
