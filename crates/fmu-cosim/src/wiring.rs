//! Connections and recorded variables, grouped by component and type for reading and writing.

use std::collections::{HashMap, HashSet};

use fmu_description::VariableType;

use crate::Scale;
use crate::system::{Link, Planned, Port};

/// What is transferred between the components and into rows.
pub(crate) struct Wiring {
    /// For each component.
    pub(crate) components: Vec<ByType<Ports>>,
    /// The number of outputs of all components.
    pub(crate) outputs: ByType<usize>,
    /// The recorded variables of continuous components, whose values before a step are recorded.
    pub(crate) before: ByType<Vec<Record>>,
    /// The recorded variables of sampled components, whose values after a step are recorded.
    pub(crate) after: ByType<Vec<Record>>,
    /// Whether variables of other types than Real are recorded, which is rare.
    pub(crate) records_others: bool,
}

/// Something for each type.
#[derive(Default)]
pub(crate) struct ByType<T> {
    pub(crate) reals: T,
    pub(crate) integers: T,
    pub(crate) booleans: T,
}

/// Variables of one component and type.
#[derive(Default)]
pub(crate) struct Ports {
    /// The connected inputs.
    pub(crate) inputs: Variables,
    /// What feeds each of them.
    pub(crate) sources: Vec<Source>,
    /// The first of the outputs that feed them, if these follow each other and none is scaled: their values
    /// need not be collected.
    pub(crate) run: Option<usize>,
    /// The variables that are connected or recorded, once each.
    pub(crate) outputs: Variables,
    /// The index of the first of them among the outputs of all components.
    pub(crate) first: usize,
}

#[derive(Default)]
pub(crate) struct Variables {
    pub(crate) references: Vec<u32>,
    pub(crate) names: Vec<String>,
}

/// The output that feeds an input.
pub(crate) struct Source {
    pub(crate) component: usize,
    /// Its index among the outputs of all components.
    pub(crate) output: usize,
    pub(crate) scale: Option<Scale>,
}

/// A recorded variable.
pub(crate) struct Record {
    pub(crate) column: usize,
    /// Its index among the outputs of all components.
    pub(crate) output: usize,
}

impl<T> ByType<T> {
    /// The thing for an Integer or an Enumeration is the same.
    fn of(&mut self, kind: VariableType) -> &mut T {
        match kind {
            VariableType::Real => &mut self.reals,
            VariableType::Boolean => &mut self.booleans,
            _ => &mut self.integers,
        }
    }
}

impl Wiring {
    pub(crate) fn new(components: &[Planned], links: &[Link], recorded: &[Port]) -> Self {
        let mut wiring = Self {
            components: components.iter().map(|_| ByType::default()).collect(),
            outputs: ByType::default(),
            before: ByType::default(),
            after: ByType::default(),
            records_others: recorded
                .iter()
                .any(|port| port.of(components).kind != VariableType::Real),
        };
        let output = wiring.add_outputs(components, links, recorded);
        for (column, port) in recorded.iter().enumerate() {
            let records = match components[port.component].sampled {
                true => &mut wiring.after,
                false => &mut wiring.before,
            };
            let output = output[port];
            let records = records.of(port.of(components).kind);
            records.push(Record { column, output });
        }
        let mut links: Vec<_> = links.iter().collect();
        links.sort_by_key(|link| link.from.component);
        for Link { from, to, scale } in links {
            let variable = to.of(components);
            let ports = wiring.components[to.component].of(variable.kind);
            ports.inputs.push(components, *to);
            ports.sources.push(Source {
                component: from.component,
                output: output[from],
                scale: *scale,
            });
        }
        for of_type in &mut wiring.components {
            for ports in [
                &mut of_type.reals,
                &mut of_type.integers,
                &mut of_type.booleans,
            ] {
                ports.run = run(&ports.sources);
            }
        }
        wiring
    }

    /// Adds all variables that are read; returns their indices.
    fn add_outputs(
        &mut self,
        components: &[Planned],
        links: &[Link],
        recorded: &[Port],
    ) -> HashMap<Port, usize> {
        let mut seen = HashSet::new();
        let connected = links.iter().map(|link| link.from);
        let mut outputs: Vec<Port> = recorded.iter().copied().chain(connected).collect();
        outputs.retain(|port| seen.insert(*port));
        outputs.sort_by_key(|port| port.component);
        let mut add = |port: Port| {
            let kind = port.of(components).kind;
            let count = self.outputs.of(kind);
            let ports = self.components[port.component].of(kind);
            if ports.outputs.references.is_empty() {
                ports.first = *count;
            }
            ports.outputs.push(components, port);
            *count += 1;
            (port, *count - 1)
        };
        outputs.into_iter().map(&mut add).collect()
    }

    /// Whether a variable of a sampled component is recorded.
    pub(crate) fn records_after_step(&self) -> bool {
        let ByType {
            reals,
            integers,
            booleans,
        } = &self.after;
        [reals, integers, booleans].iter().any(|r| !r.is_empty())
    }
}

/// See [`Ports::run`].
fn run(sources: &[Source]) -> Option<usize> {
    let first = sources.first()?.output;
    let mut all = sources.iter().zip(first..);
    all.all(|(source, output)| source.output == output && source.scale.is_none())
        .then_some(first)
}

impl Variables {
    fn push(&mut self, components: &[Planned], port: Port) {
        let variable = port.of(components);
        self.references.push(variable.reference);
        self.names.push(variable.name.clone());
    }
}
