//! A model bound to its table: the code that is generic over the model.

use std::any::Any;

use fmu_description::{
    Causality, Domain, Dynamics, Loader, Saver, Scalar as Row, Value, Variability, table,
};
use serde::{Deserialize, Serialize};

use crate::ModelError;
use crate::clock::SampleClock;
use crate::entry::Entry;
use crate::model::{Model, Start};
use crate::slave::{Guid, Numbers, Scalar, Slave};
use crate::solver::{self, System, Workspace};

/// A model with `N` scalar variables.
pub(crate) struct Bound<M, const N: usize> {
    state: Running<M>,
    entry: &'static Entry,
    /// Whether a variant uses fewer elements of an array than the table.
    is_smaller: bool,
    integrator: Integrator<M>,
}

/// The memory for steps of a model that is integrated; empty for others.
struct Integrator<M> {
    workspace: Workspace,
    /// The model before a step, to which it returns if the step fails.
    before: Option<Box<M>>,
}

/// What changes while a model is simulated.
struct Running<M> {
    model: M,
    /// Its sample instants, if it has a sample time.
    clock: SampleClock,
    integration: Integration,
}

/// How a model is integrated.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
struct Integration {
    /// Relative tolerance.
    tolerance: f64,
    /// The time until which time events are handled (s).
    handled: f64,
}

/// Where a Real is stored, and the values that it may be set to between steps.
#[derive(Clone, Copy)]
struct Place {
    /// Its offset in the model; [`Place::NONE`] if the variable is not an `f64`, or is computed only when
    /// a host asks for it.
    offset: usize,
    /// The smallest and the largest value. They are finite, which excludes NaN and infinities. The range
    /// is empty for variables that cannot be set.
    min: f64,
    max: f64,
}

impl Place {
    const NONE: usize = usize::MAX;
    /// That of no variable.
    const EMPTY: Self = Self {
        offset: Self::NONE,
        min: f64::INFINITY,
        max: f64::NEG_INFINITY,
    };

    const fn of(row: &Row) -> Self {
        let at_any_time = matches!(
            (row.variable.causality, row.variable.variability),
            (Causality::Input, _) | (Causality::Parameter, Variability::Tunable)
        );
        let is_computed_late = matches!(
            row.variable.dynamics,
            Dynamics::Derivative { .. } | Dynamics::EventIndicator
        );
        let offset = match row.offset_of_real() {
            Some(offset) if !is_computed_late => offset,
            _ => Self::NONE,
        };
        let (min, max) = match row.variable.domain {
            Domain::Real { min, max, .. } if at_any_time && offset != Self::NONE => {
                (min.max(f64::MIN), max.min(f64::MAX))
            }
            _ => (f64::INFINITY, f64::NEG_INFINITY),
        };
        Self { offset, min, max }
    }
}

/// Where the elements of a Real variable are stored, as [`Place`].
#[derive(Clone, Copy)]
struct Array {
    offset: usize,
    /// Number of elements; 0 if the reference is not that of a first element.
    count: usize,
    /// Number of elements that are in use by default.
    default: usize,
    /// Offset of the number of elements in use; [`Place::NONE`] if all are.
    size: usize,
    min: f64,
    max: f64,
}

/// Where a state and its derivative are stored.
#[derive(Clone, Copy)]
struct State {
    reference: usize,
    derivative_reference: usize,
    /// Offsets in the model.
    offset: usize,
    derivative: usize,
    nominal: f64,
}

/// Up to `N` items.
#[derive(Clone, Copy)]
struct List<T, const N: usize> {
    items: [T; N],
    length: usize,
}

impl<T: Copy, const N: usize> List<T, N> {
    const fn new(filler: T) -> Self {
        Self {
            items: [filler; N],
            length: 0,
        }
    }

    const fn push(&mut self, item: T) {
        self.items[self.length] = item;
        self.length += 1;
    }

    /// The items, without the memory for others if there are none.
    const fn as_slice(&'static self) -> &'static [T] {
        match self.length {
            0 => &[],
            length => self.items.split_at(length).0,
        }
    }
}

impl<M: Model, const N: usize> Bound<M, N> {
    /// The scalar variables, for constants only: the binary does not need them.
    pub(crate) const ROWS: &'static [Row; N] = &table::scalars(M::ROWS);
    const PLACES: &'static [Place; N] = &Self::places();
    const SCALARS: &'static [Place; N] = &Self::scalars();
    const ARRAYS: &'static [Array; N] = &Self::arrays();
    /// Whether the host may set the time derivative of any input.
    pub(crate) const HAS_INPUT_DERIVATIVES: bool = Self::has_derivatives().0;
    /// Whether derivatives of any variable with respect to others are known.
    const HAS_DIRECTIONAL_DERIVATIVES: bool = Self::has_derivatives().1;
    /// Whether there are structural parameters, and whether any of them is tunable.
    const STRUCTURAL_PARAMETERS: (bool, bool) = Self::structural_parameters();

    const fn arrays() -> [Array; N] {
        let mut arrays = [Array {
            offset: Place::NONE,
            count: 0,
            default: 0,
            size: Place::NONE,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
        }; N];
        let mut reference = 0;
        while reference < N {
            let row = &Self::ROWS[reference];
            if row.element == 0 {
                let Place { offset, min, max } = Place::of(row);
                let size = match row.size(Self::ROWS) {
                    Some(size) => Self::ROWS[size].offset_of_size(),
                    None => None,
                };
                arrays[reference] = Array {
                    offset,
                    count: row.variable.count(),
                    default: row.elements(Self::ROWS),
                    size: match size {
                        Some(offset) => offset,
                        None => Place::NONE,
                    },
                    min,
                    max,
                };
            }
            reference += 1;
        }
        arrays
    }

    /// The places of the elements that are in use by default.
    const fn places() -> [Place; N] {
        let mut places = [Place::EMPTY; N];
        let mut elements = 0;
        let mut reference = 0;
        while reference < N {
            let row = &Self::ROWS[reference];
            if row.element == 0 {
                elements = row.elements(Self::ROWS);
            }
            if row.element < elements {
                places[reference] = Place::of(row);
            }
            reference += 1;
        }
        places
    }

    /// The places of the variables that are not arrays.
    const fn scalars() -> [Place; N] {
        let mut places = [Place::EMPTY; N];
        let mut reference = 0;
        while reference < N {
            let row = &Self::ROWS[reference];
            if row.variable.count() == 1 && row.size(Self::ROWS).is_none() {
                places[reference] = Place::of(row);
            }
            reference += 1;
        }
        places
    }

    /// In the order of the derivatives.
    const STATES: &'static [State] = const { &Self::states() }.as_slice();
    /// Offsets of the event indicators.
    const EVENT_INDICATORS: &'static [usize] = const { &Self::event_indicators() }.as_slice();

    const fn states() -> List<State, N> {
        let mut states = List::new(State {
            reference: 0,
            derivative_reference: 0,
            offset: 0,
            derivative: 0,
            nominal: 1.0,
        });
        let mut reference = 0;
        while reference < N {
            let derivative = &Self::ROWS[reference];
            if let Some(of) = derivative.state(Self::ROWS)
                && let state = &Self::ROWS[of]
                && let Dynamics::State { nominal } = state.variable.dynamics
                && let (Some(derivative), Some(offset)) =
                    (derivative.offset_of_real(), state.offset_of_real())
            {
                states.push(State {
                    reference: of,
                    derivative_reference: reference,
                    offset,
                    derivative,
                    nominal,
                });
            }
            reference += 1;
        }
        states
    }

    const fn event_indicators() -> List<usize, N> {
        let mut offsets = List::new(0);
        let mut reference = 0;
        while reference < N {
            let row = &Self::ROWS[reference];
            if let (Dynamics::EventIndicator, Some(offset)) =
                (row.variable.dynamics, row.offset_of_real())
            {
                offsets.push(offset);
            }
            reference += 1;
        }
        offsets
    }

    /// Whether there are structural parameters, and whether any of them is tunable.
    const fn structural_parameters() -> (bool, bool) {
        let mut has = (false, false);
        let mut reference = 0;
        while reference < N {
            let variable = Self::ROWS[reference].variable;
            if matches!(variable.causality, Causality::StructuralParameter) {
                has.0 = true;
                has.1 |= matches!(variable.variability, Variability::Tunable);
            }
            reference += 1;
        }
        has
    }

    /// Whether any variable has an input derivative, and whether any has directional derivatives.
    const fn has_derivatives() -> (bool, bool) {
        let mut has = (false, false);
        let mut reference = 0;
        while reference < N {
            let variable = Self::ROWS[reference].variable;
            has.0 |= variable.has_input_derivative;
            has.1 |= !variable.depends_on.is_empty();
            reference += 1;
        }
        has
    }

    pub(crate) fn new(entry: &'static Entry) -> Self {
        let mut new = Self {
            state: Running {
                model: Self::start(entry),
                clock: SampleClock::default(),
                integration: Integration::default(),
            },
            entry,
            is_smaller: false,
            integrator: Integrator {
                workspace: match M::IS_INTEGRATED {
                    true => Workspace::new::<Self>(),
                    false => Workspace::default(),
                },
                before: None,
            },
        };
        let is_smaller = |array: &Array| new.length(array) < array.default;
        new.is_smaller = Self::STRUCTURAL_PARAMETERS.0 && Self::ARRAYS.iter().any(is_smaller);
        new
    }

    /// The model with its start values, those of a variant included.
    fn start(entry: &Entry) -> M {
        let mut model = M::new();
        let mut overrides = entry.overrides();
        while let Some(((reference, value), rest)) = overrides.next() {
            if let Some(variable) = model.value(reference) {
                variable.set(value.into());
            }
            overrides = rest;
        }
        model
    }

    /// Takes a step, see [`Simulate::step`](crate::Simulate::step).
    #[inline(always)]
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if M::IS_INTEGRATED {
            return self.integrate(time, step, true);
        }
        if M::IS_SAMPLED {
            self.state.sample(time, step)?;
        } else {
            self.state.model.on_step(time, step)?;
        }
        Self::check_outputs(&mut self.state.model)
    }

    /// Integrates the equations over a step, which changes nothing if it fails.
    #[inline(never)]
    fn integrate(&mut self, time: f64, size: f64, handles_events: bool) -> Result<(), ModelError> {
        self.keep_model();
        let Integration { tolerance, handled } = self.state.integration;
        let step = solver::Step {
            time,
            size,
            tolerance,
            longest: M::DEFAULT_EXPERIMENT.1.max(1e-3 * size),
            handled: handles_events.then_some(handled),
        };
        // It returns unless the model panics, after which the instance is only freed.
        let mut workspace = std::mem::take(&mut self.integrator.workspace);
        let outcome = solver::advance(self, &mut workspace, &step);
        self.integrator.workspace = workspace;
        match (outcome, &mut self.integrator.before) {
            (Ok(handled), _) => self.state.integration.handled = handled,
            (Err(error), before) => {
                if let Some(before) = before {
                    std::mem::swap(&mut self.state.model, before);
                }
                return Err(error);
            }
        }
        Ok(())
    }

    /// Keeps a copy of the model, in memory that is there after the initialization.
    fn keep_model(&mut self) {
        let model = &self.state.model;
        match &mut self.integrator.before {
            Some(before) => before.copy_from(model),
            none => *none = Some(Box::new(model.copy())),
        }
    }

    /// The tolerance of the integration, as the host wants it, or as the model says.
    fn tolerance(start: &Start) -> Result<f64, ModelError> {
        match start.tolerance {
            Some(tolerance) if tolerance > 0.0 && tolerance.is_finite() => Ok(tolerance),
            Some(tolerance) => Err(ModelError::new(format_args!(
                "the tolerance is {tolerance:?}; expected a positive number"
            ))),
            None => Ok(M::TOLERANCE),
        }
    }

    /// Checks that all Real outputs are finite.
    #[inline(always)]
    fn check_outputs(model: &mut M) -> Result<(), ModelError> {
        let sum = model.add_outputs(-0.0); // the neutral element of addition
        // As `is_finite`, in fewer instructions: zero times infinity is NaN.
        if 0.0 * sum == 0.0 {
            Ok(())
        } else {
            Self::find_not_finite(model)
        }
    }

    /// The error that names the first output that is not finite. There may be none, since a sum of
    /// finite numbers may overflow.
    #[cold]
    #[inline(never)]
    fn find_not_finite(model: &mut M) -> Result<(), ModelError> {
        for reference in 0..N {
            if let Some(row) = table::find_scalar(M::ROWS, reference)
                && row.variable.causality == Causality::Output
                && let Some(Value::Real(value)) = model.value(reference).map(|value| value.get())
                && !value.is_finite()
            {
                return Err(ModelError::new(format_args!(
                    "{} became {value}: the simulation diverges",
                    row.name()
                )));
            }
        }
        Ok(())
    }

    /// Whether fewer elements of an array are in use than the table of places has, as a variant may say.
    #[inline(always)]
    fn is_smaller(&self) -> bool {
        Self::STRUCTURAL_PARAMETERS.0 && self.is_smaller
    }

    /// Reads Reals. Returns false and writes nothing to `values` if a reference is not that of a Real.
    #[inline(always)]
    pub(crate) fn get_reals(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        !self.is_smaller() && self.get_each(Self::PLACES, references, values)
    }

    /// Writes Reals that may be set between steps. Returns false and writes nothing if a variable or
    /// value is not allowed.
    #[inline(always)]
    pub(crate) fn set_reals(&mut self, references: &[u32], values: &[f64]) -> bool {
        !self.is_smaller() && self.set_each(Self::PLACES, references, values)
    }

    /// Reads one Real per reference.
    #[inline(always)]
    fn get_each(
        &mut self,
        places: &'static [Place; N],
        references: &[u32],
        values: &mut [f64],
    ) -> bool {
        let is_real = |&reference: &u32| {
            (places.get(reference as usize)).is_some_and(|place| place.offset != Place::NONE)
        };
        // All references are checked before the first value is written.
        if !references.iter().all(is_real) {
            return false;
        }
        for (&reference, value) in references.iter().zip(values) {
            // SAFETY: the reference is that of a Real, by the check.
            *value = unsafe { *self.real_at(places.get_unchecked(reference as usize).offset) };
        }
        true
    }

    /// Writes one Real per reference.
    #[inline(always)]
    fn set_each(
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
        let all = references.iter().zip(values);
        if !all.clone().all(is_allowed) {
            return false;
        }
        for (&reference, &value) in all {
            // SAFETY: the reference is that of a Real, by the check.
            unsafe { *self.real_at(places.get_unchecked(reference as usize).offset) = value };
        }
        true
    }

    /// As [`get_reals`](Self::get_reals) for scalars of FMI 3.0.
    #[inline(always)]
    pub(crate) fn get_scalars(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        references.len() == values.len() && self.get_each(Self::SCALARS, references, values)
    }

    /// As [`set_reals`](Self::set_reals) for scalars of FMI 3.0.
    #[inline(always)]
    pub(crate) fn set_scalars(&mut self, references: &[u32], values: &[f64]) -> bool {
        references.len() == values.len() && self.set_each(Self::SCALARS, references, values)
    }

    /// As [`get_reals`](Self::get_reals) for FMI 3.0, where a reference is that of a variable with all its
    /// elements. Some values may have been written if it returns false: they are undefined after an
    /// error, and a loop that checks all references before would take 5 ns.
    #[inline(always)]
    pub(crate) fn get_arrays(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        let mut rest = values;
        for &reference in references {
            let Some(array) = Self::ARRAYS.get(reference as usize) else {
                return false;
            };
            if array.offset == Place::NONE {
                return false;
            }
            // SAFETY: the reference is that of Reals, by the check.
            let array = unsafe { self.reals(reference) };
            let Some((values, others)) = rest.split_at_mut_checked(array.len()) else {
                return false;
            };
            copy(array, values);
            rest = others;
        }
        rest.is_empty()
    }

    /// As [`set_reals`](Self::set_reals) for FMI 3.0.
    #[inline(always)]
    pub(crate) fn set_arrays(&mut self, references: &[u32], values: &[f64]) -> bool {
        let mut rest = values;
        for &reference in references {
            let Some(array) = Self::ARRAYS.get(reference as usize) else {
                return false;
            };
            let Some((values, others)) = rest.split_at_checked(self.length(array)) else {
                return false;
            };
            // The range is empty unless the variable is a Real that may be set.
            let is_allowed = |value: &f64| array.min <= *value && *value <= array.max;
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
            // SAFETY: the reference is that of Reals, by the check.
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
    fn length(&self, array: &Array) -> usize {
        if !Self::STRUCTURAL_PARAMETERS.0 || array.size == Place::NONE {
            return array.count;
        }
        let model = &raw const self.state.model;
        // SAFETY: `Variables` promises a `u64` at the offset of a structural parameter.
        let size = unsafe { *model.byte_add(array.size).cast::<u64>() };
        size.min(array.count as u64) as usize
    }

    /// The Reals of the variable with the given reference.
    ///
    /// # Safety
    /// The reference is that of a Real in `ARRAYS`.
    #[inline(always)]
    unsafe fn reals(&mut self, reference: u32) -> &mut [f64] {
        // SAFETY: the caller's promise; `Variables` promises an array of `f64` at this offset.
        unsafe {
            let array = Self::ARRAYS.get_unchecked(reference as usize);
            let length = self.length(array);
            std::slice::from_raw_parts_mut(self.real_at(array.offset), length)
        }
    }

    /// The Real with the given offset.
    ///
    /// # Safety
    /// The offset is one of the table's Reals.
    #[inline(always)]
    unsafe fn real_at(&mut self, offset: usize) -> &mut f64 {
        let model = &raw mut self.state.model;
        // SAFETY: `Variables` promises an `f64` at this offset of the model, which is borrowed mutably.
        unsafe { &mut *model.byte_add(offset).cast::<f64>() }
    }

    /// The current states, as many as there are, and zeros.
    fn current_states(&mut self) -> [f64; N] {
        let mut states = [0.0; N];
        Slave::read(self, Numbers::States, &mut states);
        states
    }

    /// Whether outputs, derivatives and event indicators are finite. As a sum of finite numbers may
    /// overflow, outputs may be, though it says that they are not.
    fn are_equations_finite(&mut self) -> bool {
        let mut sum = 0.0 * self.state.model.add_outputs(-0.0);
        let derivatives = Self::STATES.iter().map(|state| state.derivative);
        for offset in derivatives.chain(Self::EVENT_INDICATORS.iter().copied()) {
            // SAFETY: the offsets are those of the table.
            sum += 0.0 * unsafe { *self.real_at(offset) };
        }
        sum == 0.0
    }

    /// Checks that outputs, derivatives and event indicators are finite.
    fn check_equations(&mut self) -> Result<(), ModelError> {
        Self::check_outputs(&mut self.state.model)?;
        let derivatives = Self::STATES.iter().map(|state| state.derivative);
        for offset in derivatives.chain(Self::EVENT_INDICATORS.iter().copied()) {
            // SAFETY: the offsets are those of the table.
            let value = unsafe { *self.real_at(offset) };
            if !value.is_finite() {
                let rows = (0..N).filter_map(|reference| table::find_scalar(M::ROWS, reference));
                let row = { rows }.find(|row| row.offset_of_real() == Some(offset));
                let name = row.map(|row| row.name()).unwrap_or_default();
                return Err(ModelError::new(format_args!("{name} became {value}")));
            }
        }
        Ok(())
    }
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

impl<M: Model> Running<M> {
    /// Takes the samples that are due.
    #[inline(always)]
    fn sample(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        let before = self.clock;
        let due = self.clock.due(time, step)?;
        self.take(due, before)
    }

    /// Takes the last `due` samples that the clock has counted; `before` is the clock without them.
    #[inline(always)]
    fn take(&mut self, due: u32, before: SampleClock) -> Result<(), ModelError> {
        let mut remaining = due;
        while remaining > 0 {
            let sample_time = self.model.sample_time();
            let instant = self.clock.instant_before(remaining, sample_time);
            if let Err(error) = self.model.on_step(instant, sample_time) {
                if remaining < due {
                    return Err(error.broken()); // earlier samples have changed the model
                }
                self.clock = before;
                return Err(error);
            }
            remaining -= 1;
        }
        Ok(())
    }

    fn copy(&self) -> Self {
        Self {
            model: self.model.copy(),
            clock: self.clock,
            integration: self.integration,
        }
    }
}

impl<M: Model, const N: usize> System for Bound<M, N> {
    const STATES: usize = Self::STATES.len();
    const INDICATORS: usize = Self::EVENT_INDICATORS.len();

    fn nominal(&self, state: usize) -> f64 {
        Self::STATES[state].nominal
    }

    fn states(&mut self, states: &mut [f64]) {
        self.read(Numbers::States, states);
    }

    fn evaluate(&mut self, time: f64, states: &[f64]) -> Result<bool, ModelError> {
        self.set_states(states);
        self.state.model.on_evaluate(time)?;
        Ok(self.are_equations_finite() || self.check_equations().is_ok())
    }

    fn derivatives(&mut self, derivatives: &mut [f64]) {
        self.read(Numbers::Derivatives, derivatives);
    }

    fn is_positive(&mut self, indicator: usize) -> bool {
        // SAFETY: the offsets are those of the table.
        unsafe { *self.real_at(Self::EVENT_INDICATORS[indicator]) > 0.0 }
    }

    fn not_finite(&mut self) -> ModelError {
        let checked = self.check_equations();
        checked
            .err()
            .unwrap_or_else(|| ModelError::new("the states became too large"))
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        self.state.model.on_event(time)
    }

    fn next_event(&self, time: f64) -> Option<f64> {
        self.state.model.on_next_event(time)
    }
}

impl<M: Model, const N: usize> Slave for Bound<M, N> {
    fn reset(&mut self) {
        *self = Self::new(self.entry);
    }

    fn initialize(&mut self, start: &Start) -> Result<(), ModelError> {
        let mut model = M::new();
        model.copy_settable(&self.state.model);
        if Self::HAS_INPUT_DERIVATIVES {
            for reference in 0..N {
                if let Some(derivative) = model.input_derivative(reference) {
                    let set = self.state.model.input_derivative(reference);
                    *derivative = set.map_or(0.0, |value| *value);
                }
            }
        }
        model.on_initialize(start)?;
        let mut integration = Integration::default();
        if M::IS_INTEGRATED && !start.is_model_exchange {
            integration = Integration {
                tolerance: Self::tolerance(start)?,
                handled: start.time,
            };
            if start.handles_events {
                model.on_event(start.time)?;
            }
        }
        if M::IS_CONTINUOUS {
            model.on_evaluate(start.time)?;
        }
        let clock = match M::IS_SAMPLED {
            true => SampleClock::new(start.time, model.sample_time())?,
            false => SampleClock::default(),
        };
        let running = Running {
            model,
            clock,
            integration,
        };
        let before = std::mem::replace(&mut self.state, running);
        self.check_equations().map_err(|error| {
            self.state = before;
            let reason = error.reason();
            ModelError::new(format_args!("at t = {:?} s: {reason}", start.time))
        })?;
        if M::IS_INTEGRATED {
            self.keep_model();
        }
        Ok(())
    }

    fn step(&mut self, time: f64, step: f64, handles_events: bool) -> Result<(), ModelError> {
        if M::IS_INTEGRATED {
            return self.integrate(time, step, handles_events);
        }
        Self::step(self, time, step)
    }

    fn default_step(&self) -> f64 {
        M::DEFAULT_EXPERIMENT.1
    }

    fn is_sampled(&self) -> bool {
        M::IS_SAMPLED
    }

    fn is_continuous(&self) -> bool {
        M::IS_CONTINUOUS
    }

    fn evaluate(&mut self, time: f64) -> Result<(), ModelError> {
        if M::IS_CONTINUOUS {
            self.state.model.on_evaluate(time)?;
            self.check_equations().map_err(ModelError::discarded)?;
        }
        Ok(())
    }

    fn event(&mut self, time: f64) -> Result<bool, ModelError> {
        if M::IS_SAMPLED {
            let before = self.state.clock;
            let due = self.state.clock.due_until(time)?;
            self.state.take(due, before)?;
            Self::check_outputs(&mut self.state.model)?;
            return Ok(false);
        }
        let before = self.current_states();
        self.state.model.on_event(time)?;
        Ok(self.current_states() != before)
    }

    fn next_event(&self, time: f64) -> Option<f64> {
        match M::IS_SAMPLED {
            true => Some(
                self.state
                    .clock
                    .next_instant(self.state.model.sample_time()),
            ),
            false => (self.state.model.on_next_event(time)).filter(|t| *t > time && t.is_finite()),
        }
    }

    fn length(&self, of: Numbers) -> usize {
        match of {
            Numbers::EventIndicators => Self::EVENT_INDICATORS.len(),
            _ => Self::STATES.len(),
        }
    }

    fn read(&mut self, which: Numbers, values: &mut [f64]) {
        if which == Numbers::EventIndicators {
            for (offset, value) in Self::EVENT_INDICATORS.iter().zip(values) {
                // SAFETY: the offsets are those of the table.
                *value = unsafe { *self.real_at(*offset) };
            }
            return;
        }
        for (state, value) in Self::STATES.iter().zip(values) {
            // SAFETY: the offsets are those of the table.
            *value = unsafe {
                match which {
                    Numbers::Nominals => state.nominal,
                    Numbers::Derivatives => *self.real_at(state.derivative),
                    _ => *self.real_at(state.offset),
                }
            };
        }
    }

    fn set_states(&mut self, states: &[f64]) {
        for (state, value) in Self::STATES.iter().zip(states) {
            // SAFETY: the offsets are those of the table.
            unsafe { *self.real_at(state.offset) = *value };
        }
    }

    fn derivative_of(&self, state: u32) -> Option<u32> {
        let states = Self::STATES;
        let found = states.iter().find(|s| s.reference == state as usize)?;
        Some(found.derivative_reference as u32)
    }

    fn count(&self) -> usize {
        N
    }

    fn elements(&mut self, reference: u32) -> Option<usize> {
        let array = Self::ARRAYS.get(reference as usize)?;
        (array.count > 0).then(|| self.length(array))
    }

    fn is_in_fmi2(&mut self, reference: u32) -> bool {
        let Some(row) = table::find_scalar(M::ROWS, reference as usize) else {
            return false;
        };
        let array = reference.wrapping_sub(row.element as u32);
        row.variable.causality != Causality::StructuralParameter
            && (self.elements(array)).is_some_and(|elements| row.element < elements)
    }

    fn has_structural_parameter(&self, needed: Variability) -> bool {
        match needed {
            Variability::Tunable => Self::STRUCTURAL_PARAMETERS.1,
            _ => Self::STRUCTURAL_PARAMETERS.0,
        }
    }

    fn reconfigure(&mut self) -> Result<(), ModelError> {
        self.state.model.on_reconfigure()
    }

    fn find(&mut self, reference: u32) -> Option<Scalar<'_>> {
        Some(Scalar {
            row: table::find_scalar(M::ROWS, reference as usize)?,
            value: self.state.model.value(reference as usize)?,
        })
    }

    fn input_derivative(&mut self, reference: u32) -> Option<&mut f64> {
        self.state.model.input_derivative(reference as usize)
    }

    fn clear_input_derivatives(&mut self) {
        for reference in 0..N {
            if let Some(derivative) = self.state.model.input_derivative(reference) {
                *derivative = 0.0;
            }
        }
    }

    fn has_directional_derivatives(&self) -> bool {
        Self::HAS_DIRECTIONAL_DERIVATIVES
    }

    fn derivative(&self, unknown: u32, known: u32) -> f64 {
        let model = &self.state.model;
        model.directional_derivative(unknown as usize, known as usize)
    }

    fn guid(&self) -> Guid {
        self.entry.guid
    }

    fn save(&self) -> Box<dyn Any> {
        Box::new(self.state.copy())
    }

    fn restore(&mut self, saved: &dyn Any) -> bool {
        match saved.downcast_ref::<Running<M>>() {
            Some(state) => {
                self.state = state.copy();
                true
            }
            None => false,
        }
    }

    fn serialize(&self, saved: &dyn Any) -> Option<Vec<u8>> {
        let state = saved.downcast_ref::<Running<M>>()?;
        let mut saver = Saver::default();
        saver.put(&(state.clock, state.integration)).ok()?;
        state.model.save(&mut saver).ok()?;
        Some(saver.into_bytes())
    }

    fn deserialize(&self, bytes: &[u8]) -> Option<Box<dyn Any>> {
        let mut loader = Loader::new(bytes);
        let (clock, integration) = loader.take().ok()?;
        let model = M::load(&mut loader).ok()?;
        let running = Running {
            model,
            clock,
            integration,
        };
        (loader.is_empty()).then(|| Box::new(running) as Box<dyn Any>)
    }
}
