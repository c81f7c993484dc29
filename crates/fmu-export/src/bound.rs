//! A model bound to its table: the code that is generic over the model.

use std::any::Any;

use fmu_description::{
    Causality, Domain, Loader, Saver, Scalar as Row, ValueMut, Variability, table,
};

use crate::ModelError;
use crate::clock::SampleClock;
use crate::fmi2::Entry;
use crate::model::{Simulate, Start};
use crate::slave::{Guid, Scalar, Slave};

/// A model with `N` scalar variables.
pub(crate) struct Bound<M, const N: usize> {
    state: State<M>,
    entry: &'static Entry,
}

/// What changes while a model is simulated.
struct State<M> {
    model: M,
    /// Its sample instants, if it has a sample time.
    clock: SampleClock,
}

/// Where a Real is stored, and the values that it may be set to between steps.
#[derive(Clone, Copy)]
struct Place {
    /// Its offset in the model; [`Place::NONE`] if the variable is not a Real.
    offset: usize,
    /// The smallest and the largest value. They are finite, which excludes NaN and infinities. The range
    /// is empty for variables that cannot be set.
    min: f64,
    max: f64,
}

impl Place {
    const NONE: usize = usize::MAX;

    const fn of(row: &Row) -> Self {
        let at_any_time = matches!(
            (row.variable.causality, row.variable.variability),
            (Causality::Input, _) | (Causality::Parameter, Variability::Tunable)
        );
        let (min, max) = match row.variable.domain {
            Domain::Real { min, max, .. } if at_any_time => (min.max(f64::MIN), max.min(f64::MAX)),
            _ => (f64::INFINITY, f64::NEG_INFINITY),
        };
        let offset = match row.offset_of_real() {
            Some(offset) => offset,
            None => Self::NONE,
        };
        Self { offset, min, max }
    }
}

impl<M: Simulate, const N: usize> Bound<M, N> {
    /// The scalar variables, for constants only: the binary does not need them.
    pub(crate) const ROWS: &'static [Row; N] = &table::scalars(M::ROWS);
    const PLACES: &'static [Place; N] = &Self::places();
    /// Whether the host may set the time derivative of any input.
    pub(crate) const HAS_INPUT_DERIVATIVES: bool = Self::has_derivatives().0;
    /// Whether derivatives of any output with respect to inputs are known.
    const HAS_DIRECTIONAL_DERIVATIVES: bool = Self::has_derivatives().1;

    const fn places() -> [Place; N] {
        let mut places = [Place {
            offset: Place::NONE,
            min: 0.0,
            max: 0.0,
        }; N];
        let mut reference = 0;
        while reference < N {
            places[reference] = Place::of(&Self::ROWS[reference]);
            reference += 1;
        }
        places
    }

    /// Whether any variable has an input derivative, and whether any has directional derivatives.
    const fn has_derivatives() -> (bool, bool) {
        let mut has = (false, false);
        let mut reference = 0;
        while reference < N {
            let variable = Self::ROWS[reference].variable;
            has.0 |= variable.has_input_derivative;
            has.1 |= variable.has_directional_derivatives;
            reference += 1;
        }
        has
    }

    pub(crate) fn new(entry: &'static Entry) -> Self {
        Self {
            state: State {
                model: Self::start(entry),
                clock: SampleClock::default(),
            },
            entry,
        }
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

    /// See [`Simulate::step`].
    #[inline(always)]
    pub(crate) fn step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if M::IS_SAMPLED {
            self.state.sample(time, step)?;
        } else {
            self.state.model.step(time, step)?;
        }
        Self::check_outputs(&mut self.state.model)
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
                && let Some(ValueMut::Real(value)) = model.value(reference)
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

    /// Reads Reals. Returns false and writes nothing to `values` if a reference is not that of a Real.
    #[inline(always)]
    pub(crate) fn get_reals(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        let is_real = |&reference: &u32| {
            Self::PLACES
                .get(reference as usize)
                .is_some_and(|place| place.offset != Place::NONE)
        };
        // All references are checked before the first value is written.
        if !references.iter().all(is_real) {
            return false;
        }
        for (&reference, value) in references.iter().zip(values) {
            // SAFETY: the reference is that of a Real, by the check.
            *value = unsafe { *self.real(reference) };
        }
        true
    }

    /// Writes Reals that may be set between steps. Returns false and writes nothing if a variable or
    /// value is not allowed.
    #[inline(always)]
    pub(crate) fn set_reals(&mut self, references: &[u32], values: &[f64]) -> bool {
        // The range is empty unless the variable is a Real that may be set.
        let is_allowed = |(&reference, value): (&u32, &f64)| {
            Self::PLACES
                .get(reference as usize)
                .is_some_and(|place| place.min <= *value && *value <= place.max)
        };
        let all = references.iter().zip(values);
        if !all.clone().all(is_allowed) {
            return false;
        }
        for (&reference, &value) in all {
            // SAFETY: the reference is that of a Real, by the check.
            unsafe { *self.real(reference) = value };
        }
        true
    }

    /// The Real with the given reference.
    ///
    /// # Safety
    /// The reference is that of a Real.
    #[inline(always)]
    unsafe fn real(&mut self, reference: u32) -> &mut f64 {
        let model = &raw mut self.state.model;
        // SAFETY: the caller's promise; `Variables` promises an `f64` at this offset of the model, which
        // is borrowed mutably.
        unsafe {
            let place = Self::PLACES.get_unchecked(reference as usize);
            &mut *model.byte_add(place.offset).cast::<f64>()
        }
    }
}

impl<M: Simulate> State<M> {
    /// Takes the samples that are due.
    #[inline(always)]
    fn sample(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        let before = self.clock;
        let due = self.clock.due(time, step)?;
        let mut remaining = due;
        while remaining > 0 {
            let sample_time = self.model.sample_time();
            let instant = self.clock.instant_before(remaining, sample_time);
            if let Err(error) = self.model.step(instant, sample_time) {
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
        }
    }
}

impl<M: Simulate, const N: usize> Slave for Bound<M, N> {
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
        model.initialize(start)?;
        Self::check_outputs(&mut model).map_err(|error| {
            let reason = error.reason();
            ModelError::new(format_args!("at t = {:?} s: {reason}", start.time))
        })?;
        let clock = match M::IS_SAMPLED {
            true => SampleClock::new(start.time, model.sample_time())?,
            false => SampleClock::default(),
        };
        self.state = State { model, clock };
        Ok(())
    }

    fn count(&self) -> usize {
        N
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

    fn derivative(&self, output: u32, input: u32) -> f64 {
        let model = &self.state.model;
        model.directional_derivative(output as usize, input as usize)
    }

    fn guid(&self) -> Guid {
        self.entry.guid
    }

    fn save(&self) -> Box<dyn Any> {
        Box::new(self.state.copy())
    }

    fn restore(&mut self, saved: &dyn Any) -> bool {
        match saved.downcast_ref::<State<M>>() {
            Some(state) => {
                self.state = state.copy();
                true
            }
            None => false,
        }
    }

    fn serialize(&self, saved: &dyn Any) -> Option<Vec<u8>> {
        let state = saved.downcast_ref::<State<M>>()?;
        let mut saver = Saver::default();
        saver.put(&state.clock).ok()?;
        state.model.save(&mut saver).ok()?;
        Some(saver.into_bytes())
    }

    fn deserialize(&self, bytes: &[u8]) -> Option<Box<dyn Any>> {
        let mut loader = Loader::new(bytes);
        let clock = loader.take().ok()?;
        let model = M::load(&mut loader).ok()?;
        loader
            .is_empty()
            .then(|| Box::new(State { model, clock }) as Box<dyn Any>)
    }
}
