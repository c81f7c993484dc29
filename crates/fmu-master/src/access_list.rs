//! Lists of scalars of one type that are got or set by one call.

use std::collections::HashMap;

use fmu_description::{FmiVersion, Type};
use fmu_host::{Listed, operation};
use fmu_worker::Function;

use crate::Fmu;

/// The function that gets or sets variables of a type.
pub(crate) fn accessor(verb: &str, version: FmiVersion, kind: Type) -> Option<Function> {
    Function::performing(version, &operation(verb, kind))
}

/// Scalars, and the variables with which they are got or set.
#[derive(Default)]
pub(crate) struct AccessList {
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
    /// Whether they are not the first elements, in their order.
    are_mixed: bool,
    /// The first element of each array.
    arrays: HashMap<u32, usize>,
}

impl AccessList {
    /// The variables and the place of their elements in a list.
    pub(crate) fn listed(&self, first: usize) -> Listed {
        Listed::new(&self.references, first..first + self.elements)
    }

    pub(crate) fn of(fmu: &Fmu, scalars: impl IntoIterator<Item = usize>) -> Self {
        let mut wired = Self::default();
        scalars.into_iter().for_each(|scalar| wired.push(fmu, scalar));
        wired
    }

    pub(crate) fn push(&mut self, fmu: &Fmu, scalar: usize) {
        let variable = fmu.variable(scalar);
        let (reference, count) = (variable.reference, variable.element_count());
        // Aliases of scalars are accessed each on its own.
        let is_array = count > 1;
        let known = if is_array { self.arrays.get(&reference).copied() } else { None };
        let first = known.unwrap_or_else(|| {
            self.references.push(reference);
            if is_array {
                self.arrays.insert(reference, self.elements);
            }
            self.elements += count;
            self.elements - count
        });
        let position = first + fmu.scalars[scalar].element;
        self.are_mixed |= position != self.positions.len();
        self.scalars.push(scalar);
        self.positions.push(position);
        self.are_all = !self.are_mixed && self.positions.len() == self.elements;
    }
}
