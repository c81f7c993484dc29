//! A model bound to its table: the code that is generic over the model.

use std::any::Any;
use std::hint::black_box;

use fmu_description::{Causality, Domain, Info, Variability, Variable, guid};

use crate::slave::{Guid, Scalar, Slave};
use crate::{Model, ModelError};

/// A model whose table has `N` scalar variables.
pub(crate) struct Bound<M, const N: usize>(M);

/// Number of scalar variables of a model.
#[doc(hidden)]
pub const fn scalars<M: Model>() -> usize {
    let mut count = 0;
    let mut row = 0;
    while row < M::VARIABLES.len() {
        count += M::VARIABLES[row].info.count();
        row += 1;
    }
    count
}

/// The range of values that a Real may be set to between steps. Its ends are finite, which excludes
/// NaN and infinities. It is empty for variables that cannot be set, and for arrays, which may be
/// shorter in the model than in the table.
const fn writable(info: &Info) -> (f64, f64) {
    let at_any_time = matches!(
        (info.causality, info.variability),
        (Causality::Input, _) | (Causality::Parameter, Variability::Tunable)
    );
    match info.domain {
        Domain::Real { min, max, .. } if at_any_time && info.array.is_none() => {
            (min.max(f64::MIN), max.min(f64::MAX))
        }
        _ => (f64::INFINITY, f64::NEG_INFINITY),
    }
}

const fn has_input_derivatives<M>(variables: &[Variable<M>]) -> bool {
    let mut row = 0;
    while row < variables.len() {
        if variables[row].has_input_derivative() {
            return true;
        }
        row += 1;
    }
    false
}

impl<M: Model, const N: usize> Bound<M, N> {
    pub(crate) const GUID: Guid = guid::guid(M::NAME, M::VARIABLES);
    /// The row of each value reference, and the index of the element.
    const SLOTS: &'static [(u16, u16); N] = &Self::slots();
    /// Whether the host may set the time derivative of any input.
    pub(crate) const HAS_INPUT_DERIVATIVES: bool = has_input_derivatives(M::VARIABLES);
    /// See [`writable`].
    const BOUNDS: &'static [(f64, f64); N] = &Self::bounds();

    const fn slots() -> [(u16, u16); N] {
        let mut slots = [(0, 0); N];
        let mut reference = 0;
        let mut row = 0;
        while row < M::VARIABLES.len() {
            let mut element = 0;
            while element < M::VARIABLES[row].info.count() {
                slots[reference] = (row as u16, element as u16);
                reference += 1;
                element += 1;
            }
            row += 1;
        }
        assert!(reference == N, "N is the number of scalar variables");
        slots
    }

    const fn bounds() -> [(f64, f64); N] {
        let mut bounds = [(0.0, 0.0); N];
        let mut reference = 0;
        while reference < N {
            let (row, _) = Self::SLOTS[reference];
            bounds[reference] = writable(&M::VARIABLES[row as usize].info);
            reference += 1;
        }
        bounds
    }

    pub(crate) fn new() -> Self {
        let mut model = M::default();
        for variable in M::VARIABLES {
            variable.start(&mut model);
        }
        Self(model)
    }

    /// The variable of a value reference, and the index of the element.
    #[inline(always)]
    fn variable(reference: u32) -> Option<(&'static Variable<M>, usize)> {
        let &(row, element) = Self::SLOTS.get(reference as usize)?;
        Some((M::VARIABLES.get(usize::from(row))?, usize::from(element)))
    }

    /// The Real of a value reference.
    ///
    /// The first references have match arms of their own, in which the variable is a compile-time
    /// constant, so that the author's closure is inlined.
    #[inline(always)]
    fn real(model: &mut M, reference: u32) -> Option<&mut f64> {
        macro_rules! arms {
            ($($reference:literal)*) => {
                match reference {
                    $($reference => {
                        let (variable, element) = const { Self::known_variable($reference) }?;
                        variable.real(model, element)
                    })*
                    _ => {
                        let (variable, element) = Self::variable(reference)?;
                        variable.real(model, element)
                    }
                }
            };
        }
        arms! {
            0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31
            32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47
        }
    }

    /// Like [`variable`](Self::variable), at compile time.
    const fn known_variable(reference: usize) -> Option<(&'static Variable<M>, usize)> {
        if reference < N {
            let (row, element) = Self::SLOTS[reference];
            Some((&M::VARIABLES[row as usize], element as usize))
        } else {
            None
        }
    }

    /// See [`Model::step`].
    #[inline(always)]
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        self.0.step(time, step)
    }

    /// Reads Reals. Returns false and writes nothing to `values` if a reference is not that of a Real.
    #[inline(always)]
    pub(crate) fn get_reals(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        match (references, &mut *values) {
            ([reference], [value]) => self.read(*reference, value),
            _ => self.get_many(references, values),
        }
    }

    // Without `black_box`, the compiler computes the addresses of all variables before the loop.
    #[inline(never)]
    fn get_many(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        // All references are checked before the first value is written.
        references
            .iter()
            .all(|&reference| Self::real(&mut self.0, reference).is_some())
            && (references.iter().zip(values))
                .all(|(&reference, value)| black_box(&mut *self).read(reference, value))
    }

    #[inline(always)]
    fn read(&mut self, reference: u32, value: &mut f64) -> bool {
        match Self::real(&mut self.0, reference) {
            Some(real) => *value = *real,
            None => return false,
        }
        true
    }

    /// Writes Reals that may be set between steps. Returns false and writes nothing if a variable or
    /// value is not allowed. Up to four values, the usual case, are written without a loop.
    #[inline(always)]
    pub(crate) fn set_reals(&mut self, references: &[u32], values: &[f64]) -> bool {
        if references.len() > 4 {
            return self.set_many(references, values);
        }
        let may = |i| Self::may_set(references, values, i);
        may(0)
            && may(1)
            && may(2)
            && may(3)
            && self.write(references, values, 0)
            && self.write(references, values, 1)
            && self.write(references, values, 2)
            && self.write(references, values, 3)
    }

    #[inline(never)]
    fn set_many(&mut self, references: &[u32], values: &[f64]) -> bool {
        (0..references.len()).all(|i| Self::may_set(references, values, i))
            && (0..references.len()).all(|i| black_box(&mut *self).write(references, values, i))
    }

    /// Whether the value `i` may be written; true if there is none.
    #[inline(always)]
    fn may_set(references: &[u32], values: &[f64], i: usize) -> bool {
        match (references.get(i), values.get(i)) {
            (Some(&reference), Some(value)) => Self::BOUNDS
                .get(reference as usize)
                .is_some_and(|(min, max)| min <= value && value <= max),
            _ => true,
        }
    }

    /// Writes the value `i`, if there is one.
    #[inline(always)]
    fn write(&mut self, references: &[u32], values: &[f64], i: usize) -> bool {
        if let (Some(&reference), Some(&value)) = (references.get(i), values.get(i)) {
            match Self::real(&mut self.0, reference) {
                Some(real) => *real = value,
                None => return false,
            }
        }
        true
    }
}

impl<M: Model, const N: usize> Slave for Bound<M, N> {
    fn reset(&mut self) {
        *self = Self::new();
    }

    fn initialize(&mut self, start_time: f64) -> Result<(), ModelError> {
        self.0.initialize(start_time)
    }

    fn count(&self) -> usize {
        N
    }

    fn find(&mut self, reference: u32) -> Option<Scalar<'_>> {
        let (variable, element) = Self::variable(reference)?;
        Some(Scalar {
            info: &variable.info,
            element,
            value: variable.value_mut(&mut self.0, element)?,
        })
    }

    fn input_derivative(&mut self, reference: u32) -> Option<&mut f64> {
        let (variable, _) = Self::variable(reference)?;
        variable.input_derivative_mut(&mut self.0)
    }

    fn clear_input_derivatives(&mut self) {
        for variable in M::VARIABLES {
            if let Some(derivative) = variable.input_derivative_mut(&mut self.0) {
                *derivative = 0.0;
            }
        }
    }

    fn has_directional_derivatives(&self) -> bool {
        M::VARIABLES
            .iter()
            .any(Variable::has_directional_derivatives)
    }

    fn derivative(&self, output: u32, input: u32) -> f64 {
        match (Self::variable(output), Self::variable(input)) {
            (Some((output, _)), Some((input, _))) => output.derivative_by(&self.0, input.info.name),
            _ => 0.0,
        }
    }

    fn guid(&self) -> Guid {
        Self::GUID
    }

    fn save(&self) -> Box<dyn Any> {
        Box::new(self.0.clone())
    }

    fn restore(&mut self, saved: &dyn Any) -> bool {
        match saved.downcast_ref::<M>() {
            Some(model) => {
                self.0 = model.clone();
                true
            }
            None => false,
        }
    }

    fn serialize(&self, saved: &dyn Any) -> Option<Vec<u8>> {
        postcard::to_allocvec(saved.downcast_ref::<M>()?).ok()
    }

    fn deserialize(&self, bytes: &[u8]) -> Option<Box<dyn Any>> {
        match postcard::take_from_bytes::<M>(bytes) {
            Ok((model, [])) => Some(Box::new(model)),
            _ => None,
        }
    }
}
