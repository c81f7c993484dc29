//! The connections of a system, resolved and checked: every connection leads from an output to a matching input.

use std::collections::HashSet;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, MimeType, Type, Variable};

use crate::components::{Components, LoadedComponent, ScalarId};
use crate::terminals::Terminal;
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
    let mut connections = Vec::new();
    for Connection { from, to, conversion, faults } in &description.connections {
        let mut all = faults.iter();
        let checked = all.try_for_each(|fault| fault.check(description.step));
        checked.with_context(|| format!("{from} -> {to}"))?;
        if let Some(pairs) = between_terminals(components, from, to)? {
            ensure!(
                conversion.is_none() && faults.is_empty(),
                "{from} -> {to} connects terminals, expected neither a conversion nor faults"
            );
            let connected =
                |(from, to)| ResolvedConnection { from, to, conversion: None, faults: Vec::new() };
            connections.extend(pairs.into_iter().map(connected));
            continue;
        }
        let (from, to) = (components.scalar(from)?, components.settable(to)?);
        let (conversion, faults) = (*conversion, faults.clone());
        connections.push(ResolvedConnection { from, to, conversion, faults });
    }
    check(components, &connections)?;
    Ok(connections)
}

/// The connections between the members of two terminals, if the names are those of terminals and not of variables.
fn between_terminals(
    components: &Components,
    from: &str,
    to: &str,
) -> Result<Option<Vec<(ScalarId, ScalarId)>>> {
    let terminal = |name: &str| -> Result<Option<(usize, Terminal)>> {
        let Ok((component, rest)) = components.split(name) else { return Ok(None) };
        let fmu = &components[component].fmu;
        if fmu.scalar(rest).is_ok() {
            return Ok(None);
        }
        let all = fmu.terminals().with_context(|| fmu.path.display().to_string())?;
        let found = all.into_iter().find(|terminal| terminal.name == rest);
        Ok(found.map(|terminal| (component, terminal)))
    };
    let ((of_one, one), (of_other, other)) = match (terminal(from)?, terminal(to)?) {
        (None, None) => return Ok(None),
        (Some(one), Some(other)) => (one, other),
        (Some(_), None) => bail!("{from} is a terminal, but {to} is none"),
        (None, Some(_)) => bail!("{to} is a terminal, but {from} is none"),
    };
    let pairs = one.pairs(&other).with_context(|| format!("{from} -> {to}"))?;
    let connected = |(one, other)| {
        let [one, other] = [(of_one, one), (of_other, other)].map(|(component, variable)| {
            let scalar = components[component].fmu.scalar(variable);
            scalar.map(|scalar| ScalarId { component, scalar })
        });
        let (one, other) = (one?, other?);
        // A clock that the master ticks feeds one that ticks with it.
        let is_source = |id: ScalarId| {
            let variable = id.variable(components);
            variable.causality == Causality::Output || is_time_based(variable)
        };
        Ok(if is_source(one) { (one, other) } else { (other, one) })
    };
    pairs.into_iter().map(connected).collect::<Result<_>>().map(Some)
}

fn is_time_based(variable: &Variable) -> bool {
    variable.clock.is_some_and(|clock| clock.interval_variability.is_time_based())
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
            let variable = id.variable(components);
            let of_clock = variable.clock.filter(|_| expected == Causality::Input);
            let kind = of_clock.map(|clock| clock.interval_variability);
            if let Some(kind) = kind.filter(|kind| kind.is_time_based())
                && variable.causality == expected
            {
                bail!(
                    "{name} cannot be connected: it is a {} clock, which ticks at times that its FMU says; expected a triggered clock",
                    kind.as_str()
                );
            }
            let actual = variable.causality;
            let ends = [output, input].map(|id| id.variable(components).causality);
            let [a, b] = [output, input].map(|id| id.name(components));
            let hint = match ends {
                [Causality::Input, Causality::Output] => format!("; did you mean {b} -> {a}?"),
                _ => String::new(),
            };
            // The master ticks a time-based clock, and a triggered clock that is connected to it.
            let is_ticked = expected == Causality::Output && is_time_based(variable);
            ensure!(
                actual == expected || is_ticked,
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
