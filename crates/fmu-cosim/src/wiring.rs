//! Connections and recorded variables, grouped by component and type for reading and writing.

use std::collections::{HashMap, HashSet};

use fmu_description::{FmiVersion, VariableType};

use crate::recorder::Function;
use crate::system::{Link, Planned, Port};
use crate::{Scale, Variable};

/// What is transferred between the components and into rows.
pub(crate) struct Wiring {
    /// For each component.
    pub(crate) components: Vec<Transfers>,
    /// The number of outputs of all components.
    pub(crate) outputs: ByStore<usize>,
    /// The recorded variables of continuous components, whose values before a step are recorded.
    pub(crate) before: ByStore<Vec<Record>>,
    /// The recorded variables of sampled components, whose values after a step are recorded.
    pub(crate) after: ByStore<Vec<Record>>,
    /// Whether variables of other types than real numbers are recorded, which is rare.
    pub(crate) records_others: bool,
}

/// Something for each type of values: real numbers, and all others, as whole numbers.
#[derive(Default)]
pub(crate) struct ByStore<T> {
    pub(crate) reals: T,
    pub(crate) wholes: T,
}

/// What is transferred from and to a component.
pub(crate) struct Transfers {
    /// The variables with the type of Rust's `f64`: Real or Float64.
    pub(crate) reals: Ports,
    /// Those of each other type, which are rare.
    pub(crate) others: Vec<Ports>,
}

/// Variables of one component and type.
pub(crate) struct Ports {
    /// The type whose functions get and set them, and these functions.
    pub(crate) access: VariableType,
    pub(crate) get: Function,
    pub(crate) set: Function,
    /// The connected inputs.
    pub(crate) inputs: Wired,
    /// What feeds each of them.
    pub(crate) sources: Vec<Source>,
    /// The first of the outputs that feed them, if these follow each other, none is scaled, and they are
    /// all elements: their values need not be collected.
    pub(crate) run: Option<usize>,
    /// The variables that are connected or recorded, once each.
    pub(crate) outputs: Wired,
    /// The index of the first of them among the outputs of all components.
    pub(crate) first: usize,
}

/// Scalar variables and elements of arrays, and the variables with which they are got or set.
#[derive(Default)]
pub(crate) struct Wired {
    /// The value references; an array has one for all its elements.
    pub(crate) references: Vec<u32>,
    pub(crate) names: Vec<String>,
    /// Their indices in the FMU.
    pub(crate) variables: Vec<usize>,
    /// The number of elements of all variables together.
    pub(crate) elements: usize,
    /// The positions of the named ones among these.
    pub(crate) positions: Vec<usize>,
    /// Whether they are all elements, in their order.
    pub(crate) are_all: bool,
    /// The first element of each array.
    arrays: HashMap<u32, usize>,
}

/// The output that feeds an input.
pub(crate) struct Source {
    pub(crate) component: usize,
    /// Its index in the FMU, and the type whose functions get it.
    pub(crate) variable: usize,
    pub(crate) access: VariableType,
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

impl<T> ByStore<T> {
    /// That for a type.
    fn of(&mut self, access: VariableType) -> &mut T {
        match access.is_float() {
            true => &mut self.reals,
            false => &mut self.wholes,
        }
    }
}

impl Transfers {
    fn new(version: FmiVersion) -> Self {
        Self {
            reals: Ports::new(match version {
                FmiVersion::Fmi2 => VariableType::Real,
                FmiVersion::Fmi3 => VariableType::Float64,
            }),
            others: Vec::new(),
        }
    }

    fn of(&mut self, access: VariableType) -> &mut Ports {
        if is_f64(access) {
            return &mut self.reals;
        }
        let found = self.others.iter().position(|ports| ports.access == access);
        let index = found.unwrap_or_else(|| {
            self.others.push(Ports::new(access));
            self.others.len() - 1
        });
        &mut self.others[index]
    }

    fn all(&mut self) -> impl Iterator<Item = &mut Ports> {
        [&mut self.reals].into_iter().chain(&mut self.others)
    }
}

/// Whether values of this type are transferred without conversion.
fn is_f64(access: VariableType) -> bool {
    matches!(access, VariableType::Real | VariableType::Float64)
}

impl Ports {
    fn new(access: VariableType) -> Self {
        Self {
            access,
            get: Function::get(access),
            set: Function::set(access),
            inputs: Wired::default(),
            sources: Vec::new(),
            run: None,
            outputs: Wired::default(),
            first: 0,
        }
    }
}

impl Wiring {
    pub(crate) fn new(components: &[Planned], links: &[Link], recorded: &[Port]) -> Self {
        let mut wiring = Self {
            components: (components.iter())
                .map(|component| Transfers::new(component.fmu.version))
                .collect(),
            outputs: ByStore::default(),
            before: ByStore::default(),
            after: ByStore::default(),
            records_others: recorded
                .iter()
                .any(|port| !port.of(components).kind.is_float()),
        };
        let output = wiring.add_outputs(components, links, recorded);
        for (column, port) in recorded.iter().enumerate() {
            let records = match components[port.component].sampled {
                true => &mut wiring.after,
                false => &mut wiring.before,
            };
            let output = output[port];
            let records = records.of(port.of(components).access);
            records.push(Record { column, output });
        }
        let mut links: Vec<_> = links.iter().collect();
        links.sort_by_key(|link| link.from.component);
        for Link { from, to, scale } in links {
            let variable = to.of(components);
            let ports = wiring.components[to.component].of(variable.access);
            ports.inputs.push(variable, to.variable);
            ports.sources.push(Source {
                component: from.component,
                variable: from.variable,
                access: from.of(components).access,
                output: output[from],
                scale: *scale,
            });
        }
        for ports in wiring.components.iter_mut().flat_map(Transfers::all) {
            ports.run = run(&ports.sources).filter(|_| ports.inputs.are_all);
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
        outputs.sort_by_key(|port| (port.component, port.of(components).access as u8));
        let mut add = |port: Port| {
            let variable = port.of(components);
            let count = self.outputs.of(variable.access);
            let ports = self.components[port.component].of(variable.access);
            if ports.outputs.references.is_empty() {
                ports.first = *count;
            }
            ports.outputs.push(variable, port.variable);
            *count += 1;
            (port, *count - 1)
        };
        outputs.into_iter().map(&mut add).collect()
    }

    /// Whether a variable of a sampled component is recorded.
    pub(crate) fn records_after_step(&self) -> bool {
        let ByStore { reals, wholes } = &self.after;
        !reals.is_empty() || !wholes.is_empty()
    }
}

/// See [`Ports::run`].
fn run(sources: &[Source]) -> Option<usize> {
    let first = sources.first()?.output;
    let mut all = sources.iter().zip(first..);
    all.all(|(source, output)| source.output == output && source.scale.is_none())
        .then_some(first)
}

impl Wired {
    pub(crate) fn push(&mut self, variable: &Variable, index: usize) {
        let Variable {
            reference,
            element,
            count,
            ..
        } = *variable;
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
        self.names.push(variable.name.clone());
        self.variables.push(index);
        let is_last = self.positions.len() == self.elements;
        self.are_all = is_last && self.positions.is_sorted();
    }
}

#[cfg(test)]
mod tests {
    use fmu_description::{Causality, Variability};

    use super::*;

    fn variable(reference: u32, element: usize, count: usize) -> Variable {
        Variable {
            name: format!("v{reference}[{}]", element + 1),
            reference,
            element,
            count,
            kind: VariableType::Float64,
            access: VariableType::Float64,
            unsupported: None,
            start: None,
            is_structural: false,
            causality: Causality::Output,
            variability: Variability::Continuous,
            initial: None,
            unit: None,
            declared_type: None,
            items: Vec::new(),
        }
    }

    fn wired(variables: &[(u32, usize, usize)]) -> Wired {
        let mut wired = Wired::default();
        for (index, (reference, element, count)) in variables.iter().enumerate() {
            wired.push(&variable(*reference, *element, *count), index);
        }
        wired
    }

    #[test]
    fn an_array_is_accessed_once_and_its_elements_have_positions() {
        let all = wired(&[(5, 0, 1), (7, 0, 2), (7, 1, 2), (9, 0, 1)]);
        assert_eq!(all.references, [5, 7, 9]);
        assert_eq!((all.elements, all.are_all), (4, true));

        let some = wired(&[(7, 2, 3), (5, 0, 1), (7, 0, 3)]);
        assert_eq!(some.references, [7, 5]);
        assert_eq!(
            (some.elements, some.positions.as_slice()),
            (4, [2, 3, 0].as_slice())
        );
        assert!(!some.are_all);

        let reversed = wired(&[(7, 1, 2), (7, 0, 2)]);
        assert_eq!(reversed.positions, [1, 0]);
        assert!(!reversed.are_all);
    }

    #[test]
    fn aliases_are_accessed_each_on_its_own() {
        let aliases = wired(&[(5, 0, 1), (5, 0, 1)]);
        assert_eq!(aliases.references, [5, 5]);
        assert!(aliases.are_all);
    }
}
