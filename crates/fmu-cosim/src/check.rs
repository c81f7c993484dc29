//! Checks of connections: matching variables, and algebraic loops.

use std::collections::HashSet;

use anyhow::{Result, bail, ensure};
use fmu_description::{Causality, VariableType};

use crate::system::{Link, Planned, Port};

/// Checks that every connection leads from an output to a matching input, and that no input is
/// connected twice.
pub(crate) fn links(components: &[Planned], links: &[Link]) -> Result<()> {
    let mut fed = HashSet::new();
    for link in links {
        let name = |port: Port| components[port.component].name_of(port.variable);
        let (from, to) = (link.from.of(components), link.to.of(components));
        for (port, expected) in [(link.from, Causality::Output), (link.to, Causality::Input)] {
            let variable = port.of(components);
            if let Some(reason) = variable.unsupported {
                bail!("{} cannot be connected: {reason}", name(port));
            }
            let actual = variable.causality;
            ensure!(
                actual == expected,
                "{} is connected as {}, but is {}",
                name(port),
                text(expected),
                text(actual)
            );
        }
        ensure!(
            class(from.kind) == class(to.kind),
            "{} ({:?}) cannot feed {} ({:?}): the types differ",
            name(link.from),
            from.kind,
            name(link.to),
            to.kind
        );
        ensure!(
            from.kind != VariableType::String,
            "{} is a String; connections carry numbers and Booleans",
            name(link.from)
        );
        ensure!(
            link.scale.is_none() || from.kind.is_float(),
            "{} cannot feed {} with a factor: both must be real numbers",
            name(link.from),
            name(link.to)
        );
        if let (Some(a), Some(b), None) = (&from.unit, &to.unit, link.scale) {
            let (fmu, other) = (
                &components[link.from.component].fmu,
                &components[link.to.component].fmu,
            );
            ensure!(
                fmu.same_unit(a, other, b),
                "{} [{a}] cannot feed {} [{b}]: the units differ; give the connection a factor to convert them",
                name(link.from),
                name(link.to)
            );
        }
        ensure!(fed.insert(link.to), "{} is connected twice", name(link.to));
    }
    Ok(())
}

/// The type that stands for all that a variable may feed: numbers of different size are converted.
fn class(kind: VariableType) -> VariableType {
    match kind {
        _ if kind.is_float() => VariableType::Real,
        _ if kind.integer().is_some() => VariableType::Integer,
        other => other,
    }
}

fn text(causality: Causality) -> &'static str {
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

/// Rejects loops of outputs that each depend directly on the next, which no order of stepping can
/// solve. An output without declared dependencies counts as depending on no input, since most such
/// outputs change only during a step.
pub(crate) fn algebraic_loops(components: &[Planned], links: &[Link]) -> Result<()> {
    let mut settled = HashSet::new();
    for link in links {
        let mut path = Vec::new();
        if let Some(first) = find_loop(link.from, components, links, &mut path, &mut settled) {
            let start = path.iter().position(|port| *port == first).unwrap_or(0);
            let names: Vec<String> = path[start..]
                .iter()
                .chain([&first])
                .rev()
                .map(|port| components[port.component].name_of(port.variable))
                .collect();
            bail!(
                "algebraic loop in which each output depends directly on the previous one: {}; parallel order breaks the loop with a delay of one step, and allow_algebraic_loops = true runs it all the same",
                names.join(" -> ")
            );
        }
    }
    Ok(())
}

/// Follows the outputs that `output` depends on directly; returns the first one met twice.
fn find_loop(
    output: Port,
    components: &[Planned],
    links: &[Link],
    path: &mut Vec<Port>,
    settled: &mut HashSet<Port>,
) -> Option<Port> {
    if path.contains(&output) {
        return Some(output);
    }
    if settled.contains(&output) {
        return None;
    }
    path.push(output);
    let known = components[output.component].fmu.feedthrough.iter();
    let inputs = known
        .filter(|(index, _)| *index == output.variable)
        .filter_map(|(_, inputs)| inputs.as_deref())
        .flatten();
    for &variable in inputs {
        let input = Port { variable, ..output };
        for link in links.iter().filter(|link| link.to == input) {
            let found = find_loop(link.from, components, links, path, settled);
            if found.is_some() {
                return found;
            }
        }
    }
    path.pop();
    settled.insert(output);
    None
}
