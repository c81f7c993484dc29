//! What the pointer of a host points to, and the functions that a host calls at every step.
//!
//! They are compiled for each model, so that its step and the access to its variables are inlined. They
//! implement the fast path between steps, with a few checks, and leave everything else to the [`Instance`],
//! which checks thoroughly and reports errors. The fast path never accepts a call that the instance would
//! refuse.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice::{from_raw_parts, from_raw_parts_mut};

use fmi_abi::state::State;

use crate::error::ModelError;
use crate::instance::{End, Guid, Instance, Pointer, Settings, Shared, Status, Vtable};
use crate::laid_out::{LaidOut, Variant};
use crate::log::discard;
use crate::model::Model;
use crate::pointers::{NULL_ARRAY, slice, slice_mut};

/// The part of an instance that does not depend on the model; `None` for NULL.
///
/// # Safety
/// `instance` is NULL or came from [`create`], and is not freed, nor used otherwise during the lifetime.
#[inline(always)]
pub(crate) unsafe fn shared<'a>(instance: Pointer) -> Option<&'a Shared> {
    // SAFETY: every instance begins with its shared part.
    unsafe { instance.cast::<Shared>().as_ref() }
}

/// The instance behind a pointer; `None` for NULL.
///
/// # Safety
/// As [`shared`].
pub(crate) unsafe fn instance_at<'a>(instance: Pointer) -> Option<&'a mut Instance> {
    // SAFETY: the caller's promise; the functions belong to the instance.
    unsafe { shared(instance).map(|shared| &mut *(shared.vtable.instance)(instance)) }
}

/// Frees an instance. If the model's destructor panics, its memory leaks, but the host keeps running.
///
/// # Safety
/// As [`shared`], and the pointer is not used again.
pub(crate) unsafe fn free(instance: Pointer) {
    // SAFETY: the caller's promise; the functions belong to the instance.
    if let Some(free) = unsafe { shared(instance) }.map(|shared| shared.vtable.free) {
        // SAFETY: as above.
        let freed = catch_unwind(AssertUnwindSafe(|| unsafe { free(instance) }));
        let _ = freed.map_err(discard);
    }
}

/// Creates an instance of the model `M` with `N` scalar variables.
pub(crate) fn create<M: Model, const N: usize>(
    settings: Settings,
    (guid, variant): (&'static Guid, Option<Variant>),
) -> Pointer {
    let model = LaidOut::<M, N>::new(variant);
    Box::into_raw(new(settings, (guid, variant), model)).cast()
}

/// The instance of a model.
pub(crate) fn new<M: Model, const N: usize>(
    settings: Settings,
    identity: (&'static Guid, Option<Variant>),
    model: LaidOut<M, N>,
) -> Box<Instance<LaidOut<M, N>>> {
    Box::new(Instance::new(settings, &Instance::<LaidOut<M, N>>::VTABLE, identity, model))
}

/// Defines functions that get or set Float64 by a fast function of [`LaidOut`], or else by another one.
macro_rules! access {
    ($($name:ident($n:ident, *$pointer:ident f64 $(, $n_values:ident)?)
        = $fast:ident $([$places:ident])? ($slice:ident $count:ident) $(if $condition:expr)?, else $rest:path;)*) => {
        $(
            /// # Safety
            /// As for all functions of [`Vtable`].
            #[inline(never)]
            unsafe extern "C" fn $name(
                instance: Pointer,
                references: *const u32,
                $n: usize,
                values: *$pointer f64
                $(, $n_values: usize)?
            ) -> Status {
                // SAFETY: the caller's promise; no array is NULL by the check.
                unsafe {
                    let c = Self::of(instance);
                    if $($condition &&)? c.is_fast(references, values)
                        && c.model.$fast(
                            $(LaidOut::<M, N>::$places,)?
                            from_raw_parts(references, $n),
                            $slice(values, $count),
                        )
                    {
                        return Status::Ok;
                    }
                    $rest(instance, references, $n, values, $count)
                }
            }
        )*
    };
}

impl<M: Model, const N: usize> Instance<LaidOut<M, N>> {
    const VTABLE: Vtable = Vtable {
        #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
        get_elements: Self::get_elements,
        #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
        set_elements: Self::set_elements,
        #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
        get_variables: Self::get_variables,
        #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
        set_variables: Self::set_variables,
        step: Self::step,
        #[cfg(target_arch = "wasm32")]
        count: Self::count,
        instance: Self::of_any_model,
        free: Self::free,
    };

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(always)]
    unsafe fn of<'a>(instance: Pointer) -> &'a mut Self {
        // SAFETY: the caller's promise.
        unsafe { &mut *instance.cast() }
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[cfg(target_arch = "wasm32")]
    unsafe fn count(instance: Pointer, references: *const u32, n: usize) -> usize {
        // SAFETY: the caller's promise.
        let (c, references) = unsafe { (Self::of(instance), slice(references, n)) };
        let model: &mut dyn crate::laid_out::AnyModel = &mut c.model;
        let references = references.unwrap_or_default().iter();
        references.map(|&reference| model.elements(reference).unwrap_or(1)).sum()
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    unsafe fn of_any_model(instance: Pointer) -> *mut Instance {
        // SAFETY: the caller's promise.
        unsafe { Self::of(instance) }
    }

    /// # Safety
    /// As for all functions of [`Vtable`], and the pointer is not used again.
    unsafe fn free(instance: Pointer) {
        // SAFETY: `create` made the pointer from a box.
        drop(unsafe { Box::from_raw(instance.cast::<Self>()) });
    }

    /// Whether a get or set may take the fast path: between steps, with arrays that are not NULL.
    #[inline(always)]
    fn is_fast<V>(&self, references: *const u32, values: *const V) -> bool {
        self.shared.lifecycle.state == State::StepMode && !references.is_null() && !values.is_null()
    }

    access! {
        get_elements(n, *mut f64) = get_elements(from_raw_parts_mut n), else get_float64;
        set_elements(n, *const f64) = set_elements(from_raw_parts n), else set_float64;
        // Scalars; arrays are left to another function, since its registers would have to be saved here.
        get_variables(n, *mut f64, n_values)
            = get_each[SCALARS](from_raw_parts_mut n_values) if n == n_values, else Self::get_arrays;
        set_variables(n, *const f64, n_values)
            = set_each[SCALARS](from_raw_parts n_values) if n == n_values, else Self::set_arrays;
        get_arrays(n, *mut f64, n_values) = get_arrays(from_raw_parts_mut n_values), else get_float64;
        set_arrays(n, *const f64, n_values) = set_arrays(from_raw_parts n_values), else set_float64;
    }

    /// Takes a step, quickly if it is a plain one.
    ///
    /// # Safety
    /// As for all functions of [`Vtable`].
    unsafe extern "C" fn step(instance: Pointer, time: f64, step: f64, end: End) -> Status {
        // SAFETY: the caller's promise.
        unsafe {
            match Self::of(instance).is_plain_step(time, step) {
                true => Self::plain_step(instance, time, step, end),
                false => any_step(instance, time, step, end),
            }
        }
    }

    /// The rest of [`step`](Self::step), which needs no registers to be saved for a call of the model.
    ///
    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn plain_step(instance: Pointer, time: f64, step: f64, end: End) -> Status {
        // SAFETY: the caller's promise.
        let c = unsafe { Self::of(instance) };
        let take = {
            let c = &mut *c;
            move || c.take_plain_step(time, step)
        };
        match catch_unwind(AssertUnwindSafe(take)) {
            Ok(Ok(())) if c.model.model.has_finite_outputs() => {
                c.shared.lifecycle.time = time + step;
                if let Some(end) = end {
                    *end = time + step;
                }
                Status::Ok
            }
            // One arm for both would keep the result in memory in every step.
            Ok(taken) => (c as &mut Instance).end_step(Ok(taken), time, step, end),
            Err(panic) => (c as &mut Instance).end_step(Err(panic), time, step, end),
        }
    }

    /// Whether a step continues from the last one and is taken by one call of the model's function.
    #[inline(always)]
    fn is_plain_step(&self, time: f64, step: f64) -> bool {
        let lifecycle = &self.shared.lifecycle;
        !M::IS_INTEGRATED
            && lifecycle.is_next_step(time, step)
            && (!M::IS_SAMPLED || lifecycle.clock.is_one_due(time, step))
            && !(LaidOut::<M, N>::HAS_INPUT_DERIVATIVES && lifecycle.has_input_derivatives)
    }

    #[inline(always)]
    fn take_plain_step(&mut self, time: f64, step: f64) -> Result<(), ModelError> {
        if !M::IS_SAMPLED {
            return self.model.model.on_step(time, step);
        }
        let clock = &mut self.shared.lifecycle.clock;
        self.model.model.on_step(clock.next_instant(), clock.sample_time())?;
        clock.advance();
        Ok(())
    }
}

/// Defines functions that get or set Float64 in the cases that are not fast.
macro_rules! thorough_access {
    ($($name:ident(*$pointer:ident f64 as $slice:ident);)*) => { $(
        /// # Safety
        /// As for all functions of [`Vtable`].
        #[cold]
        #[inline(never)]
        unsafe extern "C" fn $name(
            instance: Pointer,
            references: *const u32,
            n: usize,
            values: *$pointer f64,
            n_values: usize,
        ) -> Status {
            // SAFETY: the caller's promise.
            let (c, arrays) = unsafe {
                let arrays = slice(references, n).zip($slice(values, n_values));
                (instance_at(instance), arrays)
            };
            c.map_or(Status::Error, |c| match arrays {
                Some((references, values)) => {
                    c.call(&c.shared.settings.edge.$name, |c| c.$name(references, values))
                }
                None => c.refuse(&c.shared.settings.edge.$name, NULL_ARRAY),
            })
        }
    )* };
}

thorough_access! {
    get_float64(*mut f64 as slice_mut);
    set_float64(*const f64 as slice);
}

/// Takes a step in the cases that are not fast.
///
/// # Safety
/// As for all functions of [`Vtable`].
#[cold]
#[inline(never)]
unsafe extern "C" fn any_step(instance: Pointer, time: f64, step: f64, end: End) -> Status {
    // SAFETY: the caller's promise.
    unsafe { instance_at(instance) }.map_or(Status::Error, |c| c.step(time, step, end))
}
