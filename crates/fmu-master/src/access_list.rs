//! Lists of scalars of one type, which one call gets or sets.
//!
//! FMI gets and sets an array as a whole. A list with the elements `m[1]` and `m[3]` of an array of three and a scalar
//! `k` has two value references, four elements, and the positions 0, 2 and 3.

use std::collections::HashMap;

use fmu_description::{FmiVersion, Type};
use fmu_host::{StepVariables, operation};
use fmu_worker::Function;

use crate::Fmu;

/// The function that gets or sets variables of a type.
pub(crate) fn accessor(verb: &str, version: FmiVersion, access_type: Type) -> Option<Function> {
    Function::performing(version, &operation(verb, access_type))
}

/// Scalars of one type, and the value references with which they are got or set.
#[derive(Default)]
pub(crate) struct AccessList {
    /// The value references; an array has one for all its elements.
    pub(crate) references: Vec<u32>,
    /// The indices of the scalars in the FMU.
    pub(crate) scalars: Vec<usize>,
    /// The number of elements of all variables together.
    pub(crate) elements: usize,
    /// The position of each scalar among the elements.
    pub(crate) positions: Vec<usize>,
    /// Whether the scalars are all elements, in their order.
    pub(crate) is_complete: bool,
    /// Whether the scalars are not the first elements, in their order.
    is_mixed: bool,
    /// The position of the first element of each array, by value reference.
    arrays: HashMap<u32, usize>,
}

impl AccessList {
    pub(crate) fn new(fmu: &Fmu, scalars: impl IntoIterator<Item = usize>) -> Self {
        let mut list = Self::default();
        scalars.into_iter().for_each(|scalar| list.push(fmu, scalar));
        list
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
        self.is_mixed |= position != self.positions.len();
        self.scalars.push(scalar);
        self.positions.push(position);
        self.is_complete = !self.is_mixed && self.positions.len() == self.elements;
    }

    /// The variables, whose elements are in a slice from this place on.
    pub(crate) fn placed_at(&self, first: usize) -> StepVariables {
        StepVariables::new(&self.references, first..first + self.elements)
    }
}
