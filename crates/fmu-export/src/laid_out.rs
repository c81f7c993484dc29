//! A model as the rest of this crate sees it: what is compiled for each model, and access to its variables.

use std::any::Any;

use dormand_prince::solver::{self, Advanced, Step, Workspace};
use fmu_description::scalar::{self, ScalarVariable};
use fmu_description::table::Declaration;
use fmu_description::{
    Causality, Dynamics, Overrides, StateError, StateReader, StateWriter, Value,
};

use crate::error::ModelError;
use crate::layout::{self, Extent, ModelInfo, Place, Tables, copy_fields, has_own_start};
use crate::log::Log;
use crate::model::{Behavior, Model};

/// A model with `N` scalar variables.
pub(crate) struct LaidOut<M, const N: usize> {
    pub(crate) model: M,
    /// Whether a variant uses fewer elements of an array than the table.
    is_smaller: bool,
}

/// The start values of a variant, and the function that sets them, which other binaries need not contain.
#[derive(Clone, Copy)]
pub(crate) struct Variant(Overrides, fn(&mut dyn AnyModel, Overrides) -> bool);

impl Variant {
    pub(crate) const fn of(overrides: Overrides) -> Option<Self> {
        match overrides.is_empty() {
            true => None,
            false => Some(Self(overrides, <dyn AnyModel>::override_starts)),
        }
    }
}

/// A model of any type. The functions on `dyn AnyModel` are compiled once.
pub(crate) trait AnyModel: Any {
    fn info(&self) -> &'static ModelInfo;
    /// The model in memory, with its variables at the offsets of the table.
    fn memory(&mut self) -> *mut u8;
    /// Sets all values to their start values, also of a variant.
    fn reset(&mut self, variant: Option<Variant>);
    /// Becomes a fresh model with the values that the host has set.
    fn renew(&mut self);
    /// The time derivative of an input, if the host may set it.
    fn input_derivative(&mut self, reference: u32) -> Option<&mut f64>;
    /// The derivative of a variable with respect to an input or a state, see
    /// [`Variables::directional_derivative`](crate::Variables::directional_derivative).
    fn derivative(&self, unknown: u32, known: u32) -> f64;
    /// Checks that all Real outputs are finite.
    fn check_outputs(&mut self) -> Result<(), ModelError>;
    /// A hash of the variables that cause an event by a new value, if the model is integrated and has any; else 0.
    fn hash_of_switches(&mut self) -> u128;
    /// Integrates the equations over a step.
    fn advance(&mut self, with: &mut Workspace, step: &Step) -> Result<Advanced, ModelError>;
    /// What the author has written.
    fn behavior(&self) -> &dyn Behavior;
    fn behavior_mut(&mut self) -> &mut dyn Behavior;
    fn copy(&self) -> Box<dyn AnyModel>;
    /// Copies another model into the memory of this one; false if it is of another type.
    fn assign(&mut self, from: &dyn AnyModel) -> bool;
    fn save(&self, to: &mut StateWriter) -> Result<(), StateError>;
    /// Some fields may be loaded if that fails.
    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError>;
}

impl<M: Model, const N: usize> LaidOut<M, N> {
    /// The scalar variables, for constants only: the binary does not need them.
    pub(crate) const ROWS: &'static [ScalarVariable; N] = &scalar::scalars(M::ROWS);
    const TABLES: Tables<N> = Tables::of(Self::ROWS);
    const INFO: ModelInfo = ModelInfo {
        rows: M::ROWS,
        count: N,
        arrays: &const { Self::TABLES.arrays },
        states: const { &const { Self::TABLES.states } }.as_slice(),
        event_indicators: const { &const { Self::TABLES.event_indicators } }.as_slice(),
        is_sampled: M::IS_SAMPLED,
        is_continuous: M::IS_CONTINUOUS,
        is_integrated: M::IS_INTEGRATED,
        step: M::DEFAULT_EXPERIMENT.1,
        tolerance: M::TOLERANCE,
        has_directional_derivatives: M::IS_CONTINUOUS
            && matches!(Self::TABLES.directional_derivatives, (true, false)),
        structural_parameters: Self::TABLES.structural_parameters,
        has_log: M::HAS_LOG,
        is_unsaved: M::IS_UNSAVED,
    };
    pub(crate) const HAS_INPUT_DERIVATIVES: bool = Self::TABLES.has_input_derivatives;
    const HAS_STRUCTURAL_PARAMETERS: bool = Self::TABLES.structural_parameters.0;
    const ELEMENTS: &'static [Place; N] = &const { Self::TABLES.elements };
    pub(crate) const SCALARS: &'static [Place; N] = &const { Self::TABLES.scalars };
    const VARIABLES: &'static [Place; N] = &const { Self::TABLES.variables };

    pub(crate) fn of(model: M) -> Self {
        Self { model, is_smaller: false }
    }

    pub(crate) fn new(variant: Option<Variant>) -> Self {
        let mut new = Self::of(M::new());
        new.is_smaller = variant.is_some_and(|Variant(overrides, set)| set(&mut new, overrides));
        new
    }

    /// As [`get_each`](Self::get_each) for scalars and elements of arrays in use, but writes nothing if it returns
    /// false.
    #[inline(always)]
    pub(crate) fn get_elements(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        let is_real = |&reference: &u32| {
            let place = Self::ELEMENTS.get(reference as usize);
            place.is_some_and(|place| place.offset != Place::NONE)
        };
        !self.is_smaller()
            && (references.len() == 1 || references.iter().all(is_real))
            && self.get_each(Self::ELEMENTS, references, values)
    }

    /// As [`set_each`](Self::set_each) for scalars and elements of arrays in use.
    #[inline(always)]
    pub(crate) fn set_elements(&mut self, references: &[u32], values: &[f64]) -> bool {
        !self.is_smaller() && self.set_each(Self::ELEMENTS, references, values)
    }

    /// Whether a variant uses fewer elements of an array than `ELEMENTS` assumes.
    #[inline(always)]
    fn is_smaller(&self) -> bool {
        Self::HAS_STRUCTURAL_PARAMETERS && self.is_smaller
    }

    /// Gets what is at some of the places. Returns false if a reference is not of a Float64 there; values of others
    /// may have been written.
    #[inline(always)]
    pub(crate) fn get_each(
        &mut self,
        places: &'static [Place; N],
        references: &[u32],
        values: &mut [f64],
    ) -> bool {
        let mut get = |(&reference, value): (&u32, &mut f64)| match places.get(reference as usize) {
            Some(&Place { offset, .. }) if offset != Place::NONE => {
                // SAFETY: the reference belongs to a Real, by the check.
                *value = unsafe { *real_at(self.memory(), offset) };
                true
            }
            _ => false,
        };
        // Many models have one output, for which a loop would take longer than the access.
        match (references, values) {
            ([reference], [value]) => get((reference, value)),
            (references, values) => references.iter().zip(values).all(get),
        }
    }

    /// Sets what is at some of the places. Returns false and writes nothing if a variable or value is not
    /// allowed between steps.
    #[inline(always)]
    pub(crate) fn set_each(
        &mut self,
        places: &'static [Place; N],
        references: &[u32],
        values: &[f64],
    ) -> bool {
        // The range is empty unless the variable is a Real that may be set.
        let is_allowed = |(&reference, value): (&u32, &f64)| {
            (places.get(reference as usize))
                .is_some_and(|place| place.min <= *value && *value <= place.max)
        };
        // SAFETY: the reference belongs to a Real, by the check.
        let mut set = |(&reference, &value): (&u32, &f64)| unsafe {
            *real_at(self.memory(), places.get_unchecked(reference as usize).offset) = value;
        };
        // As for getting.
        if let ([reference], [value]) = (references, values) {
            let is_set = is_allowed((reference, value));
            if is_set {
                set((reference, value));
            }
            return is_set;
        }
        let all = references.iter().zip(values);
        let are_set = all.clone().all(is_allowed);
        if are_set {
            all.for_each(set);
        }
        are_set
    }

    /// As [`get_each`](Self::get_each), where a reference stands for a variable with all its
    /// elements. Some values may have been written if it returns false: they are undefined after an error,
    /// and a loop that checks all references before would take 5 ns.
    #[inline(always)]
    pub(crate) fn get_arrays(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        let mut rest = values;
        for &reference in references {
            match Self::VARIABLES.get(reference as usize) {
                Some(place) if place.offset != Place::NONE => {}
                _ => return false,
            }
            // SAFETY: the reference belongs to Reals, by the check.
            let array = unsafe { self.reals(reference) };
            let Some((values, others)) = rest.split_at_mut_checked(array.len()) else {
                return false;
            };
            copy(array, values);
            rest = others;
        }
        rest.is_empty()
    }

    /// As [`set_elements`](Self::set_elements), where a reference stands for a variable with all its
    /// elements.
    #[inline(always)]
    pub(crate) fn set_arrays(&mut self, references: &[u32], values: &[f64]) -> bool {
        let mut rest = values;
        for &reference in references {
            let Some(place) = Self::VARIABLES.get(reference as usize) else {
                return false;
            };
            let length = self.length(&Self::INFO.arrays[reference as usize]);
            let Some((values, others)) = rest.split_at_checked(length) else {
                return false;
            };
            // The range is empty unless the variable is a Real that may be set.
            let is_allowed = |value: &f64| place.min <= *value && *value <= place.max;
            if values.is_empty() || !values.iter().all(is_allowed) {
                return false;
            }
            rest = others;
        }
        if !rest.is_empty() {
            return false;
        }
        let mut rest = values;
        for &reference in references {
            // SAFETY: the reference belongs to Reals, by the check.
            let array = unsafe { self.reals(reference) };
            let Some((values, others)) = rest.split_at_checked(array.len()) else {
                return false;
            };
            copy(values, array);
            rest = others;
        }
        true
    }

    /// The number of elements in use.
    #[inline(always)]
    fn length(&mut self, array: &Extent) -> usize {
        match Self::HAS_STRUCTURAL_PARAMETERS {
            // SAFETY: the entry is one of this model.
            true => unsafe { in_use(self.memory(), array) },
            false => array.count as usize,
        }
    }

    /// The Reals of the variable with the given reference.
    ///
    /// # Safety
    /// The reference belongs to a Float64 in the table of variables.
    #[inline(always)]
    unsafe fn reals(&mut self, reference: u32) -> &mut [f64] {
        // SAFETY: the caller's promise; `Variables` promises an array of `f64` at this offset.
        unsafe {
            let place = Self::VARIABLES.get_unchecked(reference as usize);
            let length = self.length(Self::INFO.arrays.get_unchecked(reference as usize));
            std::slice::from_raw_parts_mut(real_at(self.memory(), place.offset), length)
        }
    }
}

/// The number of elements in use.
///
/// # Safety
/// The entry is one of the table of the model.
#[inline(always)]
unsafe fn in_use(model: *mut u8, array: &Extent) -> usize {
    if array.size == Extent::ALL {
        return array.count as usize;
    }
    // SAFETY: `Variables` promises a `u64` at the offset of a structural parameter.
    let size = unsafe { *model.byte_add(array.size as usize).cast::<u64>() };
    size.min(u64::from(array.count)) as usize
}

/// The Real with the given offset in a model.
///
/// # Safety
/// The offset is one of the Reals in the table of the model, which is borrowed mutably for `'a`.
#[inline(always)]
unsafe fn real_at<'a>(model: *mut u8, offset: usize) -> &'a mut f64 {
    // SAFETY: `Variables` promises an `f64` at this offset.
    unsafe { &mut *model.byte_add(offset).cast::<f64>() }
}

/// Copies numbers to a slice of the same length. Most are one or a few, for which a call of `memcpy` would
/// take longer.
#[inline(always)]
fn copy(from: &[f64], to: &mut [f64]) {
    match (from, to) {
        ([from], [to]) => *to = *from,
        (from, to) if (2..=4).contains(&from.len()) => copy_ends::<2>(from, to),
        (from, to) if (5..=8).contains(&from.len()) => copy_ends::<4>(from, to),
        (from, to) => to.copy_from_slice(from),
    }
}

/// Copies the first and the last `K` numbers, which may overlap.
#[inline(always)]
fn copy_ends<const K: usize>(from: &[f64], to: &mut [f64]) {
    if let (Some(from), Some(to)) = (from.first_chunk::<K>(), to.first_chunk_mut()) {
        *to = *from;
    }
    if let (Some(from), Some(to)) = (from.last_chunk::<K>(), to.last_chunk_mut()) {
        *to = *from;
    }
}

impl<M: Model, const N: usize> AnyModel for LaidOut<M, N> {
    fn info(&self) -> &'static ModelInfo {
        &const { Self::INFO }
    }

    #[inline(always)]
    fn memory(&mut self) -> *mut u8 {
        (&raw mut self.model).cast()
    }

    fn reset(&mut self, variant: Option<Variant>) {
        *self = Self::new(variant);
    }

    fn renew(&mut self) {
        use Causality::{Input, Parameter, StructuralParameter};
        let mut fresh = M::new();
        let to = (&raw mut fresh).cast();
        let is_settable = |field: &Declaration| {
            matches!(field.causality, Input | Parameter | StructuralParameter)
        };
        // SAFETY: both are models with these rows.
        unsafe { copy_fields(to, self.memory(), M::ROWS, is_settable) };
        if Self::HAS_INPUT_DERIVATIVES {
            for reference in 0..N {
                if let Some(derivative) = fresh.input_derivative(reference) {
                    let set = self.model.input_derivative(reference);
                    *derivative = set.map_or(0.0, |value| *value);
                }
            }
        }
        if let (Some(log), Some(own)) = (fresh.log(), self.model.log()) {
            std::mem::swap(log, own);
        }
        self.model = fresh;
    }

    fn input_derivative(&mut self, reference: u32) -> Option<&mut f64> {
        self.model.input_derivative(reference as usize)
    }

    fn derivative(&self, unknown: u32, known: u32) -> f64 {
        let model = &self.model;
        model.directional_derivative(unknown as usize, known as usize)
    }

    fn check_outputs(&mut self) -> Result<(), ModelError> {
        match self.model.has_finite_outputs() {
            true => Ok(()),
            false => (self as &mut dyn AnyModel).find_not_finite(),
        }
    }

    fn hash_of_switches(&mut self) -> u128 {
        match M::IS_INTEGRATED && Self::TABLES.has_switches {
            // SAFETY: the rows are those of the model.
            true => unsafe { layout::hash_of_switches(self.memory(), M::ROWS) },
            false => 0,
        }
    }

    fn advance(&mut self, with: &mut Workspace, step: &Step) -> Result<Advanced, ModelError> {
        // The solver takes the steps of models without their own, and in event mode, which FMI 3.0 has, those of all
        // with equations. It is in no other library.
        const HAS_EVENT_MODE: bool = cfg!(any(feature = "fmi3", not(feature = "fmi2")));
        match M::IS_INTEGRATED || M::IS_CONTINUOUS && HAS_EVENT_MODE {
            true => solver::advance(&mut Equations(self), with, step),
            false => Err(ModelError::refuse("the model has no equations")),
        }
    }

    fn behavior(&self) -> &dyn Behavior {
        &self.model
    }

    fn behavior_mut(&mut self) -> &mut dyn Behavior {
        &mut self.model
    }

    fn copy(&self) -> Box<dyn AnyModel> {
        Box::new(Self { model: self.model.copy(), is_smaller: self.is_smaller })
    }

    fn assign(&mut self, from: &dyn AnyModel) -> bool {
        let from = (from as &dyn Any).downcast_ref::<Self>();
        from.map(|from| self.model.copy_from(&from.model)).is_some()
    }

    fn save(&self, to: &mut StateWriter) -> Result<(), StateError> {
        self.model.save(to)
    }

    fn load(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.model.load(from)
    }
}

/// SolverVector that a host integrates, or locates events with, in the order of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SolverVector {
    States,
    Derivatives,
    Nominals,
    EventIndicators,
}

impl dyn AnyModel {
    /// Connects the log of the model, if it has one.
    pub(crate) fn connect(&mut self, to: &Log) {
        if let Some(log) = self.behavior_mut().log() {
            log.clone_from(to);
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
    fn override_starts(&mut self, mut overrides: Overrides) -> bool {
        while let Some((start, rest)) = overrides.next() {
            if let Some(scalar) = self.find(start.reference as u32)
                && let Some(value) = start.value(scalar.variable.start.of_type())
            {
                self.set(&scalar, value);
            }
            overrides = rest;
        }
        let arrays = match self.info().structural_parameters.0 {
            true => self.info().arrays,
            false => &[],
        };
        let mut in_use = (0..).zip(arrays).filter(|(_, array)| array.count > 0);
        in_use.any(|(reference, array)| self.elements(reference) < Some(array.default as usize))
    }

    /// The scalar variable with the given value reference.
    pub(crate) fn find(&self, reference: u32) -> Option<ScalarVariable> {
        scalar::scalar_at(self.info().rows, reference as usize)
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
    pub(crate) fn elements(&mut self, reference: u32) -> Option<usize> {
        let array = self.info().arrays.get(reference as usize)?;
        // SAFETY: the entry is one of this model.
        (array.count > 0).then(|| unsafe { in_use(self.memory(), array) })
    }

    /// Whether a host can address the scalar of a reference by itself: it is no structural parameter, and an element in
    /// use of an array.
    pub(crate) fn is_element(&mut self, scalar: &ScalarVariable, reference: u32) -> bool {
        let first = reference.wrapping_sub(scalar.element as u32);
        scalar.variable.causality != Causality::StructuralParameter
            && self.elements(first).is_some_and(|elements| scalar.element < elements)
    }

    /// Whether any of the variables is computed only when a host asks for it.
    pub(crate) fn has_derivatives(&self, references: &[u32]) -> bool {
        let info = self.info();
        let are_there = !(info.states.is_empty() && info.event_indicators.is_empty());
        are_there
            && references.iter().any(|&reference| {
                self.find(reference).is_some_and(|scalar| {
                    matches!(
                        scalar.variable.dynamics,
                        Dynamics::Derivative { .. } | Dynamics::EventIndicator
                    )
                })
            })
    }

    /// How many of these numbers there are.
    pub(crate) fn length(&self, of: SolverVector) -> usize {
        match of {
            SolverVector::EventIndicators => self.info().event_indicators.len(),
            _ => self.info().states.len(),
        }
    }

    /// Reads as many of these numbers as there are values.
    pub(crate) fn read(&mut self, which: SolverVector, values: &mut [f64]) {
        let info = self.info();
        for (i, value) in values.iter_mut().enumerate().take(self.length(which)) {
            let offset = match which {
                SolverVector::Nominals => {
                    *value = info.states[i].nominal;
                    continue;
                }
                SolverVector::EventIndicators => info.event_indicators[i],
                SolverVector::Derivatives => info.states[i].derivative_offset,
                SolverVector::States => info.states[i].state_offset,
            };
            // SAFETY: the offsets come from the table.
            *value = unsafe { *real_at(self.memory(), offset) };
        }
    }

    pub(crate) fn event_indicator(&mut self, index: usize) -> f64 {
        // SAFETY: the offsets come from the table.
        unsafe { *real_at(self.memory(), self.info().event_indicators[index]) }
    }

    /// Sets the first states.
    pub(crate) fn set_states(&mut self, states: &[f64]) {
        for (state, value) in self.info().states.iter().zip(states) {
            // SAFETY: the offsets come from the table.
            unsafe { *real_at(self.memory(), state.state_offset) = *value };
        }
    }

    /// Evaluates the equations for an event, which can read event indicators and derivatives for the current inputs. An
    /// event may mend what cannot be evaluated; if it does not, the next evaluation fails.
    pub(crate) fn evaluate_before_event(&mut self, time: f64) {
        let _ = self.behavior_mut().on_evaluate(time);
    }

    /// The current states.
    pub(crate) fn states(&mut self) -> Vec<f64> {
        let mut states = vec![0.0; self.length(SolverVector::States)];
        self.read(SolverVector::States, &mut states);
        states
    }

    /// The error that names the first output that is not finite, if there is one.
    #[cold]
    #[inline(never)]
    fn find_not_finite(&mut self) -> Result<(), ModelError> {
        for reference in 0..self.info().count as u32 {
            if let Some(scalar) = self.find(reference)
                && scalar.variable.causality == Causality::Output
                && let Some(value) = self.get(&scalar).as_real()
                && !value.is_finite()
            {
                return Err(ModelError::new(format_args!(
                    "{} became {value}: the simulation diverges",
                    scalar.name()
                )));
            }
        }
        Ok(())
    }

    /// Checks that outputs, derivatives and event indicators are finite.
    pub(crate) fn check_equations(&mut self) -> Result<(), ModelError> {
        self.check_outputs()?;
        let info = self.info();
        let derivatives = info.states.iter().map(|state| state.derivative_offset);
        for offset in derivatives.chain(info.event_indicators.iter().copied()) {
            // SAFETY: the offsets come from the table.
            let value = unsafe { *real_at(self.memory(), offset) };
            if !value.is_finite() {
                return Err(self.not_finite(offset, value));
            }
        }
        Ok(())
    }

    #[cold]
    fn not_finite(&self, offset: usize, value: f64) -> ModelError {
        let mut all = (0..self.info().count as u32).filter_map(|reference| self.find(reference));
        let found = all.find(|scalar| scalar.offset_of_real() == Some(offset));
        let name = found.map(|scalar| scalar.name()).unwrap_or_default();
        ModelError::new(format_args!("{name} became {value}"))
    }

    /// Sets all input derivatives to zero.
    pub(crate) fn clear_input_derivatives(&mut self) {
        for reference in 0..self.info().count as u32 {
            if let Some(derivative) = self.input_derivative(reference) {
                *derivative = 0.0;
            }
        }
    }
}

/// The equations of a model, as the solver sees them.
struct Equations<'a>(&'a mut (dyn AnyModel + 'static));

impl solver::System for Equations<'_> {
    type Error = ModelError;

    fn nominal(&self, state: usize) -> f64 {
        self.0.info().states[state].nominal
    }

    fn states(&mut self, states: &mut [f64]) -> Result<(), ModelError> {
        self.0.read(SolverVector::States, states);
        Ok(())
    }

    fn evaluate(&mut self, time: f64, states: &[f64]) -> Result<bool, ModelError> {
        self.0.set_states(states);
        self.0.behavior_mut().on_evaluate(time)?;
        Ok(self.0.check_equations().is_ok())
    }

    fn derivatives(&mut self, derivatives: &mut [f64]) {
        self.0.read(SolverVector::Derivatives, derivatives);
    }

    fn event_indicator(&mut self, indicator: usize) -> f64 {
        self.0.event_indicator(indicator)
    }

    fn not_finite(&mut self) -> ModelError {
        let checked = self.0.check_equations();
        checked.err().unwrap_or_else(|| ModelError::new("the states became too large"))
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        self.0.behavior_mut().on_event(time)
    }

    fn next_event(&self, time: f64) -> Option<f64> {
        self.0.behavior().on_next_event(time)
    }
}
