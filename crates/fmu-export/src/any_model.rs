//! A model of any type, as the code that is compiled once sees it: what is compiled for each model, and access to its variables.

use std::any::Any;
use std::iter::repeat_n;

use fmu_description::derive::Timing;
use fmu_description::scalar::{self, ScalarVariable};
use fmu_description::{
    Causality, Dynamics, Naming, Number, StartOverrides, StateError, StateReader, StateWriter,
    Value,
};
use ode_methods::solver::{Advanced, Step, Workspace};

use crate::error::ModelError;
use crate::layout::{
    self, ContinuousState, EventIndicators, Extent, ModelInfo, copy_fields, elements_in_use,
    float64_at, has_own_start,
};
use crate::log::Log;
use crate::model::Behavior;

/// A model of any type. The functions on `dyn AnyModel` are compiled once.
pub(crate) trait AnyModel: Any {
    fn info(&self) -> &'static ModelInfo;
    /// How the names of variables are written.
    fn naming(&self) -> Naming;
    /// The model in memory, with its variables at the offsets of the table.
    fn memory(&mut self) -> *mut u8;
    /// The elements of the variable whose first element has the given value reference; `None` for other references.
    fn extent(&self, reference: u32) -> Option<Extent>;
    /// Sets all values to their start values, also of a variant.
    fn reset(&mut self, variant: Option<VariantStarts>);
    /// Becomes a fresh model with the values that the host has set.
    fn renew(&mut self);
    /// The time derivative of the input with a number, if the host may set it.
    fn input_derivative(&mut self, number: u32) -> Option<&mut f64>;
    /// The derivative of a variable with respect to an input or a state, by their numbers, see
    /// [`Variables::directional_derivative`](crate::Variables::directional_derivative).
    fn derivative(&self, unknown: u32, known: u32) -> f64;
    /// The interval and the shift that the model calculates for the clock with a number.
    fn clock_timing(&self, number: u32) -> Option<Timing>;
    /// Checks that all Real outputs are finite.
    fn check_outputs(&mut self) -> Result<(), ModelError>;
    /// A hash of the variables that cause an event by a new value, if the model is integrated and has any; else 0.
    fn hash_of_switches(&mut self) -> u128;
    /// The memory for steps of the integration.
    fn workspace(&self) -> Workspace
    where
        Self: Sized;
    /// Integrates the equations over a step.
    fn integrate(&mut self, with: &mut Workspace, step: &Step) -> Result<Advanced, ModelError>;
    /// The functions that the author has written.
    fn behavior(&self) -> &dyn Behavior;
    fn behavior_mut(&mut self) -> &mut dyn Behavior;
    fn copy(&self) -> Box<dyn AnyModel>;
    /// Copies another model into the memory of this one; false if it is of another type.
    fn assign(&mut self, from: &dyn AnyModel) -> bool;
    fn save(&self, to: &mut StateWriter) -> Result<(), StateError>;
    /// Some fields may be loaded if that fails.
    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError>;
}

impl dyn AnyModel {
    /// Connects the logs of the model.
    pub(crate) fn connect_logs(&mut self, to: &Log) {
        let (mut index, categories) = (0, self.info().log_categories);
        while let Some((log, own)) = self.behavior_mut().log(index) {
            *log = to.in_category(categories, own);
            index += 1;
        }
    }

    /// Takes the start values of outputs and local variables from another model of its type.
    pub(crate) fn take_starts(&mut self, from: &mut Self) {
        if (*self).type_id() == (*from).type_id() {
            // SAFETY: both are models with these rows.
            unsafe { copy_fields(self.memory(), from.memory(), self.info().rows, has_own_start) };
        }
    }

    /// Sets the start values of a variant. Returns whether it uses fewer elements of an array than the table.
    fn override_starts(&mut self, mut overrides: StartOverrides) -> bool {
        while let Some((start, rest)) = overrides.next() {
            if let Some(scalar) = self.scalar_at(start.reference as u32)
                && let Some(value) = start.value(scalar.variable.start.of_type())
            {
                self.set(&scalar, value);
            }
            overrides = rest;
        }
        let info = self.info();
        info.has_structural_parameters
            && (0..info.end).any(|reference| {
                let default = self.extent(reference).map(|array| array.default as usize);
                self.elements_in_use(reference) < default
            })
    }

    /// The scalar variable with the given value reference.
    pub(crate) fn scalar_at(&self, reference: u32) -> Option<ScalarVariable> {
        let number = self.info().number(reference)?;
        let mut scalar = scalar::scalar_at(self.info().rows, number as usize)?;
        (scalar.reference, scalar.naming) = (reference as usize, self.naming());
        Some(scalar)
    }

    /// All scalar variables, in the order of the fields.
    pub(crate) fn scalars(&self) -> impl Iterator<Item = ScalarVariable> + Clone + use<> {
        let (info, naming) = (self.info(), self.naming());
        (0..info.count).filter_map(move |number| {
            let mut scalar = scalar::scalar_at(info.rows, number as usize)?;
            let reference = info.reference(number) as usize;
            (scalar.reference, scalar.naming) = (reference, naming);
            Some(scalar)
        })
    }

    pub(crate) fn get(&mut self, scalar: &ScalarVariable) -> Value {
        // SAFETY: `Variables` promises a value of the type of the table at this place of the model.
        unsafe { layout::get(self.memory().byte_add(scalar.absolute_offset()), scalar.variable) }
    }

    pub(crate) fn set(&mut self, scalar: &ScalarVariable, value: Value) {
        // SAFETY: as above; the model is borrowed mutably.
        unsafe {
            layout::set(self.memory().byte_add(scalar.absolute_offset()), scalar.variable, value)
        }
    }

    /// Number of elements in use of the variable whose first element has the given value reference;
    /// `None` for other references.
    pub(crate) fn elements_in_use(&mut self, reference: u32) -> Option<usize> {
        let array = self.extent(reference)?;
        // SAFETY: the entry is one of this model.
        Some(unsafe { elements_in_use(self.memory(), &array) })
    }

    /// Whether a host can address the scalar of a reference by itself: it is no structural parameter, and an element in
    /// use of an array.
    pub(crate) fn is_element(&mut self, scalar: &ScalarVariable) -> bool {
        let first = (scalar.reference - scalar.element) as u32;
        scalar.variable.causality != Causality::StructuralParameter
            && self.elements_in_use(first).is_some_and(|elements| scalar.element < elements)
    }

    /// Whether any of the variables is computed only when a host asks for it.
    pub(crate) fn has_derivatives(&self, references: &[u32]) -> bool {
        let info = self.info();
        let are_there = !(info.states.is_empty() && info.event_indicators.is_empty());
        are_there
            && references.iter().any(|&reference| {
                self.scalar_at(reference).is_some_and(|scalar| {
                    matches!(
                        scalar.variable.dynamics,
                        Dynamics::Derivative { .. } | Dynamics::EventIndicator
                    )
                })
            })
    }

    /// How many of these numbers there are.
    pub(crate) fn vector_length(&self, vector: SolverVector) -> usize {
        self.vector_parts(vector).map(|part| part.count).sum()
    }

    /// The variables with these numbers.
    fn vector_parts(&self, which: SolverVector) -> impl Iterator<Item = VectorPart> + use<> {
        let info = self.info();
        let (states, indicators): (&[_], &[_]) = match which {
            SolverVector::EventIndicators => (&[], info.event_indicators),
            _ => (info.states, &[]),
        };
        let of_state = move |v: &ContinuousState| {
            let is_derivative = which == SolverVector::Derivatives;
            let offset = if is_derivative { v.derivative_offset } else { v.state_offset };
            VectorPart { offset, count: v.count, nominal: v.nominal }
        };
        let of_indicator =
            |v: &EventIndicators| VectorPart { offset: v.offset, count: v.count, nominal: 1.0 };
        states.iter().map(of_state).chain(indicators.iter().map(of_indicator))
    }

    /// The part with one of these numbers, reduced to this number.
    fn vector_part(&self, which: SolverVector, mut index: usize) -> Option<VectorPart> {
        for part in self.vector_parts(which) {
            if index < part.count {
                let offset = part.offset + index * size_of::<f64>();
                return Some(VectorPart { offset, count: 1, ..part });
            }
            index -= part.count;
        }
        None
    }

    /// The numbers themselves.
    fn vector(&mut self, which: SolverVector) -> impl Iterator<Item = &mut f64> {
        let memory = self.memory();
        self.vector_parts(which).flat_map(move |part| {
            // SAFETY: the offsets come from the table, and no two numbers are at the same place.
            let at = move |i| unsafe { float64_at(memory, part.offset + i * size_of::<f64>()) };
            (0..part.count).map(at)
        })
    }

    /// Reads as many of these numbers as there are values.
    pub(crate) fn read_vector(&mut self, which: SolverVector, values: &mut [f64]) {
        if which == SolverVector::Nominals {
            let nominals =
                self.vector_parts(which).flat_map(|part| repeat_n(part.nominal, part.count));
            values.iter_mut().zip(nominals).for_each(|(value, nominal)| *value = nominal);
            return;
        }
        values.iter_mut().zip(self.vector(which)).for_each(|(value, number)| *value = *number);
    }

    /// Multiplies the derivatives of the states' derivatives with respect to the states by a direction of the states.
    pub(crate) fn multiply_jacobian(&self, direction: &[f64], products: &mut [f64]) {
        let info = self.info();
        let numbers = |reference: fn(&ContinuousState) -> u32| {
            let elements = move |state: &ContinuousState| {
                let first = reference(state);
                (0..state.count as u32).map(move |element| info.number(first + element))
            };
            info.states.iter().flat_map(elements)
        };
        for (product, unknown) in products.iter_mut().zip(numbers(|state| state.derivative)) {
            let columns = direction.iter().zip(numbers(|state| state.state));
            let terms = columns.filter(|(change, _)| **change != 0.0).map(|(change, known)| {
                let numbers = unknown.zip(known);
                change * numbers.map_or(0.0, |(unknown, known)| self.derivative(unknown, known))
            });
            *product = terms.sum();
        }
    }

    /// The nominal value of a state.
    pub(crate) fn nominal(&self, state: usize) -> f64 {
        self.vector_part(SolverVector::Nominals, state).map_or(1.0, |part| part.nominal)
    }

    pub(crate) fn event_indicator(&mut self, index: usize) -> f64 {
        let part = self.vector_part(SolverVector::EventIndicators, index);
        // SAFETY: the offsets come from the table.
        part.map_or(0.0, |part| unsafe { *float64_at(self.memory(), part.offset) })
    }

    /// Sets the first states.
    pub(crate) fn set_states(&mut self, states: &[f64]) {
        self.vector(SolverVector::States).zip(states).for_each(|(state, value)| *state = *value);
    }

    /// Evaluates the equations for an event, which can read event indicators and derivatives for the current inputs. An
    /// event may mend what cannot be evaluated; if it does not, the next evaluation fails.
    pub(crate) fn evaluate_before_event(&mut self, time: f64) {
        let _ = self.behavior_mut().on_evaluate(time);
    }

    /// The current states.
    pub(crate) fn states(&mut self) -> Vec<f64> {
        let mut states = vec![0.0; self.vector_length(SolverVector::States)];
        self.read_vector(SolverVector::States, &mut states);
        states
    }

    /// The error that names the first output that is not finite, if there is one.
    #[cold]
    #[inline(never)]
    pub(crate) fn find_not_finite(&mut self) -> Result<(), ModelError> {
        for scalar in self.scalars() {
            if scalar.variable.causality == Causality::Output
                && let Some(value) = self.get(&scalar).as_real()
                && !value.is_finite()
            {
                return Err(became(&scalar.name(), value));
            }
        }
        Ok(())
    }

    /// Checks that outputs, derivatives and event indicators are finite.
    pub(crate) fn check_equations(&mut self) -> Result<(), ModelError> {
        self.check_outputs()?;
        for which in [SolverVector::Derivatives, SolverVector::EventIndicators] {
            let found = self.vector(which).position(|number| !number.is_finite());
            if let Some(part) = found.and_then(|index| self.vector_part(which, index)) {
                return Err(self.not_finite(part.offset));
            }
        }
        Ok(())
    }

    #[cold]
    fn not_finite(&mut self, offset: usize) -> ModelError {
        // SAFETY: the offset comes from the table.
        let value = unsafe { *float64_at(self.memory(), offset) };
        let found = self.scalars().find(|scalar| scalar.offset_of_real() == Some(offset));
        let name = found.map(|scalar| scalar.name()).unwrap_or_default();
        became(&name, value)
    }

    /// Sets all input derivatives to zero.
    pub(crate) fn clear_input_derivatives(&mut self) {
        for number in 0..self.info().count {
            if let Some(derivative) = self.input_derivative(number) {
                *derivative = 0.0;
            }
        }
    }
}

/// The error of a value that is not finite.
#[cold]
fn became(name: &str, value: f64) -> ModelError {
    let cause = match value.is_nan() {
        true => {
            "an invalid operation, such as 0/0, inf - inf or the square root of a negative number"
        }
        false => "the simulation diverges, or a number was divided by zero",
    };
    ModelError::new(format_args!("{name} became {}: {cause}", Number(value)))
}

/// The numbers that a solver exchanges with a model, in the order of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SolverVector {
    States,
    Derivatives,
    Nominals,
    EventIndicators,
}

/// The numbers of a variable.
struct VectorPart {
    /// Offset of the first in the model.
    offset: usize,
    /// How many there are.
    count: usize,
    nominal: f64,
}

/// The start values of a variant, and the function that sets them, which other binaries need not contain.
#[derive(Clone, Copy)]
pub(crate) struct VariantStarts {
    overrides: StartOverrides,
    set: fn(&mut dyn AnyModel, StartOverrides) -> bool,
}

impl VariantStarts {
    pub(crate) const fn new(overrides: StartOverrides) -> Option<Self> {
        match overrides.is_empty() {
            true => None,
            false => Some(Self { overrides, set: <dyn AnyModel>::override_starts }),
        }
    }

    /// Sets the start values. Returns whether the variant uses fewer elements of an array than the table.
    pub(crate) fn set(self, model: &mut dyn AnyModel) -> bool {
        (self.set)(model, self.overrides)
    }
}
