//! Connections and recorded variables, grouped by component and type for reading and writing.

use std::collections::{HashMap, HashSet};

use fmu_description::{FmiVersion, Type};
use fmu_host::operation;
use fmu_worker::Function;

use crate::plan::{Link, Planned, Port};
use crate::{Fmu, Scale};

/// What is transferred between the components and into rows.
pub(crate) struct Wiring {
    /// For each component.
    pub(crate) components: Vec<Transfers>,
    /// The number of outputs of all components: those of the type Float64, and the others.
    pub(crate) counts: [usize; 2],
    /// The recorded variables of continuous components, whose values before a step are recorded.
    pub(crate) before: Records,
    /// The recorded variables of sampled components, whose values after a step are recorded.
    pub(crate) after: Records,
}

/// Recorded variables: their indices among the outputs of all components and in a row. Values are stored
/// in the same way in both.
#[derive(Default)]
pub(crate) struct Records {
    pub(crate) reals: Vec<(usize, usize)>,
    pub(crate) others: Vec<(usize, usize)>,
}

/// What is transferred from and to a component.
pub(crate) struct Transfers {
    version: FmiVersion,
    /// The variables of the type Float64.
    pub(crate) reals: Ports,
    /// Those of each other type, which are rare.
    pub(crate) others: Vec<Ports>,
}

/// Variables of one component and type.
pub(crate) struct Ports {
    /// The type whose functions get and set them, and these functions.
    pub(crate) kind: Type,
    pub(crate) get: Option<Function>,
    pub(crate) set: Option<Function>,
    /// The connected inputs, and what feeds each of them.
    pub(crate) inputs: Wired,
    pub(crate) sources: Vec<Source>,
    /// The first of the Float64 outputs that feed them, if these follow each other, none is scaled, and they
    /// are all elements: their values need not be collected.
    pub(crate) run: Option<usize>,
    /// The variables that are connected or recorded, once each, and the place of the first.
    pub(crate) outputs: Wired,
    pub(crate) first: Place,
}

/// A place among values of the type Float64, or among the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "see above")]
pub enum Place {
    Real(usize),
    Other(usize),
}

/// The output that feeds an input.
pub(crate) struct Source {
    pub(crate) component: usize,
    /// Its index in the FMU, and the type whose functions get it.
    pub(crate) scalar: usize,
    pub(crate) kind: Type,
    /// Its place among the outputs of all components.
    pub(crate) output: Place,
    pub(crate) scale: Option<Scale>,
}

/// Scalars, and the variables with which they are got or set.
#[derive(Default)]
pub(crate) struct Wired {
    /// The value references; an array has one for all its elements.
    pub(crate) references: Vec<u32>,
    /// Their indices in the FMU.
    pub(crate) scalars: Vec<usize>,
    /// The number of elements of all variables together.
    pub(crate) elements: usize,
    /// The positions of the scalars among these.
    pub(crate) positions: Vec<usize>,
    /// Whether they are all elements, in their order.
    pub(crate) are_all: bool,
    /// The first element of each array.
    arrays: HashMap<u32, usize>,
}

impl Transfers {
    fn of(&mut self, kind: Type) -> &mut Ports {
        if kind == Type::Float64 {
            return &mut self.reals;
        }
        let found = self.others.iter().position(|ports| ports.kind == kind);
        let index = found.unwrap_or_else(|| {
            self.others.push(Ports::new(self.version, kind));
            self.others.len() - 1
        });
        &mut self.others[index]
    }

    /// The variables of all types.
    pub(crate) fn all(&self) -> impl Iterator<Item = &Ports> {
        [&self.reals].into_iter().chain(&self.others)
    }
}

impl Ports {
    fn new(version: FmiVersion, kind: Type) -> Self {
        Self {
            kind,
            get: Function::of(version, &operation("get", kind)),
            set: Function::of(version, &operation("set", kind)),
            inputs: Wired::default(),
            sources: Vec::new(),
            run: None,
            outputs: Wired::default(),
            first: Place::Other(0),
        }
    }
}

impl Wiring {
    pub(crate) fn new(components: &[Planned], links: &[Link], recorded: &[Port]) -> Self {
        let transfers = components.iter().map(|component| Transfers {
            version: component.fmu.version,
            reals: Ports::new(component.fmu.version, Type::Float64),
            others: Vec::new(),
        });
        let mut wiring = Self {
            components: transfers.collect(),
            counts: [0; 2],
            before: Records::default(),
            after: Records::default(),
        };
        let outputs = wiring.add_outputs(components, links, recorded);
        let kinds = recorded.iter().map(|port| port.of(components).of_type);
        for (port, column) in recorded.iter().zip(places(kinds)) {
            let records = match components[port.component].sampled {
                true => &mut wiring.after,
                false => &mut wiring.before,
            };
            match (outputs[port], column) {
                (Place::Real(from), Place::Real(to)) => records.reals.push((from, to)),
                (Place::Real(from) | Place::Other(from), Place::Real(to) | Place::Other(to)) => {
                    records.others.push((from, to));
                }
            }
        }
        let mut links: Vec<_> = links.iter().collect();
        links.sort_by_key(|link| link.from.component);
        for Link { from, to, scale } in links {
            let ports = wiring.components[to.component].of(to.access(components));
            ports.inputs.push(&components[to.component].fmu, to.scalar);
            ports.sources.push(Source {
                component: from.component,
                scalar: from.scalar,
                kind: from.access(components),
                output: outputs[from],
                scale: *scale,
            });
        }
        for Transfers { reals, .. } in &mut wiring.components {
            reals.run = run(&reals.sources).filter(|_| reals.inputs.are_all);
        }
        wiring
    }

    /// Adds all variables that are read; returns their places.
    fn add_outputs(
        &mut self,
        components: &[Planned],
        links: &[Link],
        recorded: &[Port],
    ) -> HashMap<Port, Place> {
        let mut seen = HashSet::new();
        let connected = links.iter().map(|link| link.from);
        let mut outputs: Vec<Port> = recorded.iter().copied().chain(connected).collect();
        outputs.retain(|port| seen.insert(*port));
        outputs.sort_by_key(|port| (port.component, port.access(components) as u8));
        let add = |port: Port| {
            let kind = port.access(components);
            let ports = self.components[port.component].of(kind);
            let place = Place::next(kind, &mut self.counts);
            if ports.outputs.references.is_empty() {
                ports.first = place;
            }
            ports
                .outputs
                .push(&components[port.component].fmu, port.scalar);
            (port, place)
        };
        outputs.into_iter().map(add).collect()
    }
}

impl Place {
    pub(crate) fn plus(self, offset: usize) -> Self {
        match self {
            Self::Real(index) => Self::Real(index + offset),
            Self::Other(index) => Self::Other(index + offset),
        }
    }

    /// The next place of a type, which is counted.
    fn next(kind: Type, [reals, others]: &mut [usize; 2]) -> Self {
        let (count, first) = match kind {
            Type::Float64 => (reals, Self::Real(0)),
            _ => (others, Self::Other(0)),
        };
        *count += 1;
        first.plus(*count - 1)
    }
}

/// The places in a row of columns of these types.
pub(crate) fn places(kinds: impl Iterator<Item = Type>) -> impl Iterator<Item = Place> {
    let mut counts = [0; 2];
    kinds.map(move |kind| Place::next(kind, &mut counts))
}

/// See [`Ports::run`].
fn run(sources: &[Source]) -> Option<usize> {
    let Place::Real(first) = sources.first()?.output else {
        return None;
    };
    let mut all = sources.iter().zip(first..);
    all.all(|(source, index)| source.output == Place::Real(index) && source.scale.is_none())
        .then_some(first)
}

impl Wired {
    pub(crate) fn push(&mut self, fmu: &Fmu, scalar: usize) {
        let variable = fmu.variable(scalar);
        self.add(
            variable.reference,
            fmu.scalars[scalar].element,
            variable.count(),
        );
        self.scalars.push(scalar);
    }

    /// Adds an element of a variable with a value reference and a number of elements.
    fn add(&mut self, reference: u32, element: usize, count: usize) {
        let first = match self.arrays.get(&reference) {
            Some(first) if count > 1 => *first,
            _ => {
                self.references.push(reference);
                self.arrays.insert(reference, self.elements);
                self.elements += count;
                self.elements - count
            }
        };
        self.positions.push(first + element);
        let is_last = self.positions.len() == self.elements;
        self.are_all = is_last && self.positions.is_sorted();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_is_accessed_once_and_its_elements_have_positions() {
        for (variables, references, positions, are_all) in [
            // Value reference, element and number of elements of each scalar.
            (
                vec![(5, 0, 1), (7, 0, 2), (7, 1, 2)],
                vec![5, 7],
                vec![0, 1, 2],
                true,
            ),
            (
                vec![(7, 2, 3), (5, 0, 1), (7, 0, 3)],
                vec![7, 5],
                vec![2, 3, 0],
                false,
            ),
            (vec![(7, 1, 2), (7, 0, 2)], vec![7], vec![1, 0], false),
            // Aliases are accessed each on its own.
            (vec![(5, 0, 1), (5, 0, 1)], vec![5, 5], vec![0, 1], true),
        ] {
            let mut wired = Wired::default();
            for (reference, element, count) in variables {
                wired.add(reference, element, count);
            }
            assert_eq!((wired.references, wired.positions), (references, positions));
            assert_eq!(wired.are_all, are_all);
        }
    }
}
