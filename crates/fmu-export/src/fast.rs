//! The calls that a host makes at every step: get and set Float64, and step.
//!
//! They are compiled for each model, so that its step and the access to its variables are inlined. The pointer of a
//! host points to a [`HostedInstance`], which begins with its [`Vtable`]: an entry point, such as `fmi2DoStep`, calls
//! the function of this table with the same arguments.
//!
//! Between steps, these functions take a fast path with a few checks. They leave all other cases to the [`Instance`],
//! which checks thoroughly and reports errors. The fast path never accepts a call that the instance would refuse.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::NonNull;
use std::slice::{from_raw_parts, from_raw_parts_mut};
use std::sync::atomic::{AtomicU32, Ordering};

use fmi_abi::FmiFunction;
use fmi_abi::state::State;

use crate::any_model::AnyModel;
use crate::clock_functions::ClockFunctions;
use crate::error::ModelError;
use crate::instance::{Edge, HAS_CLOCKS, Identity, Instance, Settings, Status, StepEnd};
use crate::laid_out::LaidOut;
use crate::large::{self, Part};
use crate::layout::{Extent, Float64Place, elements_in_use, float64_at};
use crate::log::discard;
use crate::model::Model;
use crate::pointers::{NULL_ARRAY, Pointer, slice, slice_mut};
use crate::preemption::Preemption;

/// What the pointer of a host points to.
#[repr(C)]
pub(crate) struct HostedInstance<M: ?Sized = dyn AnyModel> {
    pub(crate) head: Head,
    pub(crate) instance: Instance<M>,
}

/// The part of a hosted instance that an entry point finds without knowing the model.
pub(crate) struct Head {
    pub(crate) vtable: &'static Vtable,
    /// Whether the host sees what happens in a step, which is then taken in parts.
    pub(crate) is_stepped_in_parts: bool,
    pub(crate) edge: &'static Edge,
    /// The functions of clocks, if the model has some.
    pub(crate) clock_functions: Option<&'static ClockFunctions>,
    preemption: Option<NonNull<Preemption>>,
    /// The callbacks of the host that are in progress, after which calls go on.
    callbacks: AtomicU32,
}

impl Head {
    /// Lets one call at a time use the instance, if the host may preempt calls.
    fn preemption(&self) -> Option<&Preemption> {
        // SAFETY: it belongs to the settings of the instance, and lives as long as the head.
        self.preemption.filter(|_| HAS_CLOCKS).map(|preemption| unsafe { preemption.as_ref() })
    }
}

/// The functions that are compiled for each model. The pointer is to a hosted instance of this model, which is not
/// used concurrently or otherwise during the call; pointers to arrays are NULL or valid for the lengths that
/// follow them. A binary for one version of FMI does not contain the functions of the other.
pub(crate) struct Vtable {
    /// Gets scalars and elements of arrays: `n` value references, and as many values.
    #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
    pub(crate) get_elements: unsafe extern "C" fn(Pointer, *const u32, usize, *mut f64) -> Status,
    #[cfg(any(feature = "fmi2", not(feature = "fmi3")))]
    pub(crate) set_elements: unsafe extern "C" fn(Pointer, *const u32, usize, *const f64) -> Status,
    /// Gets variables with all their elements: `n` value references, and the values.
    #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
    pub(crate) get_variables:
        unsafe extern "C" fn(Pointer, *const u32, usize, *mut f64, usize) -> Status,
    #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
    pub(crate) set_variables:
        unsafe extern "C" fn(Pointer, *const u32, usize, *const f64, usize) -> Status,
    /// Takes a step.
    pub(crate) step: unsafe extern "C" fn(Pointer, f64, f64, StepEnd) -> Status,
    /// The number of elements of variables; an unknown one counts as one.
    #[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
    pub(crate) count_elements: unsafe fn(Pointer, *const u32, usize) -> usize,
    instance: unsafe fn(Pointer) -> *mut Instance,
    free: unsafe fn(Pointer),
}

/// The head of a hosted instance; `None` for NULL.
///
/// # Safety
/// `pointer` is NULL or came from [`create`], and is not freed, nor used otherwise during the lifetime.
#[inline(always)]
pub(crate) unsafe fn head<'a>(pointer: Pointer) -> Option<&'a Head> {
    // SAFETY: every hosted instance begins with its head.
    unsafe { pointer.cast::<Head>().as_ref() }
}

/// Performs an operation of the instance behind a pointer, if the call is allowed; an error for NULL.
///
/// # Safety
/// As [`head`]; the instance may be in use by a call that the host has preempted.
pub(crate) unsafe fn call(
    pointer: Pointer,
    call: &FmiFunction,
    mut operation: impl FnMut(&mut Instance) -> Result<(), ModelError>,
) -> Status {
    // SAFETY: the caller's promise.
    unsafe { guard(pointer, call, &mut operation) }
}

/// The code of [`call`] that all calls share.
///
/// # Safety
/// As [`call`].
#[inline(never)]
unsafe fn guard(
    pointer: Pointer,
    call: &FmiFunction,
    operation: &mut dyn FnMut(&mut Instance) -> Result<(), ModelError>,
) -> Status {
    // SAFETY: the caller's promise.
    unsafe { use_instance(pointer, call, |instance| instance.guard(call, operation)) }
}

/// Logs why a call of the instance behind a pointer fails.
///
/// # Safety
/// As [`call`].
#[cold]
#[inline(never)]
pub(crate) unsafe fn refuse(pointer: Pointer, call: &FmiFunction, reason: &str) -> Status {
    // SAFETY: the caller's promise.
    unsafe { use_instance(pointer, call, |instance| instance.refuse(call, reason)) }
}

/// Does something with the instance behind a pointer, unless a preempted call is doing so; an error for NULL.
///
/// # Safety
/// As [`call`].
#[inline(always)]
pub(crate) unsafe fn use_instance(
    pointer: Pointer,
    call: &FmiFunction,
    operation: impl FnOnce(&mut Instance) -> Status,
) -> Status {
    // SAFETY: the caller's promise.
    let Some(head) = (unsafe { head(pointer) }) else { return Status::Error };
    let preemption = head.preemption();
    if preemption.is_some_and(|preemption| !preemption.begin(call)) {
        return Status::Error;
    }
    // SAFETY: as above; no other call uses the instance, either by the caller's promise or as it is excluded.
    let status = operation(unsafe { &mut *(head.vtable.instance)(pointer) });
    if let Some(preemption) = preemption {
        preemption.end();
    }
    status
}

/// The instance behind a pointer; `None` for NULL.
///
/// # Safety
/// As [`head`], and no call is in progress.
pub(crate) unsafe fn instance_at<'a>(pointer: Pointer) -> Option<&'a mut Instance> {
    // SAFETY: the caller's promise; the functions belong to the instance.
    unsafe { head(pointer).map(|head| &mut *(head.vtable.instance)(pointer)) }
}

/// Calls the host, which may call functions of the instance meanwhile, but not free it.
///
/// # Safety
/// As [`head`]; no reference to the instance is held.
pub(crate) unsafe fn call_back<T>(pointer: Pointer, callback: impl FnOnce() -> T) -> T {
    // SAFETY: the caller's promise; no reference is held during the callback.
    let callbacks = || unsafe { head(pointer) }.map(|head| &head.callbacks);
    callbacks().map(|count| count.fetch_add(1, Ordering::Relaxed));
    let returned = callback();
    callbacks().map(|count| count.fetch_sub(1, Ordering::Relaxed));
    returned
}

/// Frees an instance. If the model's destructor panics, its memory leaks, but the host keeps running.
///
/// # Safety
/// As [`head`], and the pointer is not used again.
pub(crate) unsafe fn free(pointer: Pointer) {
    // SAFETY: the caller's promise; the functions belong to the instance.
    let Some(head) = (unsafe { head(pointer) }) else { return };
    // What a preempted call uses, or one that calls the host, cannot be freed.
    let is_in_use = head.preemption().is_some_and(Preemption::is_in_use);
    if !is_in_use && head.callbacks.load(Ordering::Relaxed) == 0 {
        let free = head.vtable.free;
        // SAFETY: as above.
        let freed = catch_unwind(AssertUnwindSafe(|| unsafe { free(pointer) }));
        let _ = freed.map_err(discard);
    }
}

/// Creates an instance of the model `M` with tables of size `N`; `None` if the process can have one only, and has it.
pub(crate) fn create<M: Model, const N: usize>(
    mut settings: Settings,
    identity: Identity,
) -> Option<Pointer> {
    if let Some(single) = M::single_instance() {
        settings.place = Some(Box::new(single.take()?));
    }
    let model = LaidOut::<M, N>::new(identity.variant, identity.naming);
    Some(Box::into_raw(HostedInstance::new(settings, identity, model)).cast())
}

/// As [`create`], for a model with clocks: in scheduled execution, a host may preempt calls of the instance.
pub(crate) fn create_preemptible<M: Model, const N: usize>(
    settings: Settings,
    identity: Identity,
) -> Option<Pointer> {
    let scheduling = settings.scheduling();
    let preemption = scheduling.map(|scheduling| NonNull::from(&*scheduling.preemption));
    let pointer = create::<M, N>(settings, identity)?;
    if preemption.is_some() {
        // SAFETY: the pointer is to a new instance of the model.
        let hosted = unsafe { HostedInstance::<LaidOut<M, N>>::at(pointer) };
        hosted.head.vtable = &HostedInstance::<LaidOut<M, N>>::PREEMPTIBLE;
        hosted.head.preemption = preemption;
    }
    Some(pointer)
}

impl<M: Model, const N: usize> HostedInstance<LaidOut<M, N>> {
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
        #[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
        count_elements: Self::count_elements,
        instance: Self::instance,
        free: Self::free,
    };
    /// Functions that use the instance only if no preempted call does.
    const PREEMPTIBLE: Vtable = Vtable {
        #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
        get_variables: get_float64,
        #[cfg(any(feature = "fmi3", not(feature = "fmi2")))]
        set_variables: set_float64,
        step: refuse_step,
        ..Self::VTABLE
    };

    pub(crate) fn new(settings: Settings, identity: Identity, model: LaidOut<M, N>) -> Box<Self> {
        let clock_functions = identity.clock_functions;
        let instance = Instance::new(settings, identity, model);
        let is_stepped_in_parts = instance.shared.settings.is_stepped_in_parts();
        let edge = instance.shared.settings.edge;
        let vtable = &Self::VTABLE;
        let head = Head {
            vtable,
            is_stepped_in_parts,
            edge,
            clock_functions,
            preemption: None,
            callbacks: AtomicU32::new(0),
        };
        Box::new(Self { head, instance })
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(always)]
    unsafe fn at<'a>(pointer: Pointer) -> &'a mut Self {
        // SAFETY: the caller's promise.
        unsafe { &mut *pointer.cast() }
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    unsafe fn instance(pointer: Pointer) -> *mut Instance {
        // SAFETY: the caller's promise.
        unsafe { &mut Self::at(pointer).instance }
    }

    /// # Safety
    /// As for all functions of [`Vtable`], and the pointer is not used again.
    unsafe fn free(pointer: Pointer) {
        // SAFETY: `create` made the pointer from a box.
        let mut hosted = unsafe { Box::from_raw(pointer.cast::<Self>()) };
        let place = hosted.instance.shared.settings.place.take();
        // The next instance may be created when the model is dropped.
        #[cfg(not(all(target_arch = "wasm32", feature = "sources")))]
        drop(hosted);
        #[cfg(all(target_arch = "wasm32", feature = "sources"))]
        {
            /// Not compiled with the model, for speed.
            #[inline(never)]
            fn free_shared(shared: crate::instance::Shared) {
                drop(shared);
            }
            let Instance { shared, model } = hosted.instance;
            drop(model);
            free_shared(shared);
        }
        drop(place);
    }
}

/// Steps.
impl<M: Model, const N: usize> HostedInstance<LaidOut<M, N>> {
    /// Takes a step, quickly if it is a plain one.
    ///
    /// # Safety
    /// As for all functions of [`Vtable`].
    unsafe extern "C" fn step(pointer: Pointer, time: f64, step: f64, end: StepEnd) -> Status {
        // SAFETY: the caller's promise.
        unsafe {
            match Self::at(pointer).is_plain_step(time, step) {
                true => Self::plain_step(pointer, time, step, end),
                false => any_step(pointer, time, step, end),
            }
        }
    }

    /// Whether a step continues from the last one and is taken by one call of the model's function.
    #[inline(always)]
    fn is_plain_step(&self, time: f64, step: f64) -> bool {
        let lifecycle = &self.instance.shared.lifecycle;
        !M::IS_INTEGRATED
            && M::RATES.is_empty()
            && lifecycle.is_next_step(time, step)
            && (!M::IS_SAMPLED || lifecycle.clock.is_one_due(time, step))
            && !(LaidOut::<M, N>::HAS_INPUT_DERIVATIVES && lifecycle.has_input_derivatives)
    }

    /// The rest of [`step`](Self::step), which needs no registers to be saved for a call of the model.
    ///
    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn plain_step(
        pointer: Pointer,
        time: f64,
        step: f64,
        end: StepEnd,
    ) -> Status {
        // SAFETY: the caller's promise.
        let instance = unsafe { &mut Self::at(pointer).instance };
        let take = {
            let instance = &mut *instance;
            move || Self::take_plain_step(instance, time, step)
        };
        match catch_unwind(AssertUnwindSafe(take)) {
            Ok(Ok(())) if instance.model.model.has_finite_outputs() => {
                instance.shared.lifecycle.time = time + step;
                if let Some(end) = end {
                    *end = time + step;
                }
                Status::Ok
            }
            // One arm for both would keep the result in memory in every step.
            Ok(taken) => (instance as &mut Instance).end_step(Ok(taken), time, step, end),
            Err(panic) => (instance as &mut Instance).end_step(Err(panic), time, step, end),
        }
    }

    #[inline(always)]
    fn take_plain_step(
        instance: &mut Instance<LaidOut<M, N>>,
        time: f64,
        step: f64,
    ) -> Result<(), ModelError> {
        let model = &mut instance.model.model;
        if !M::IS_SAMPLED {
            return model.on_step(time, step);
        }
        let clock = &mut instance.shared.lifecycle.clock;
        model.on_step(clock.next_instant(), clock.sample_time())?;
        clock.advance();
        Ok(())
    }
}

/// Takes a step in the cases that are not fast.
///
/// # Safety
/// As for all functions of [`Vtable`].
#[cold]
#[inline(never)]
unsafe extern "C" fn any_step(pointer: Pointer, time: f64, step: f64, end: StepEnd) -> Status {
    // SAFETY: the caller's promise.
    unsafe { instance_at(pointer) }.map_or(Status::Error, |instance| instance.step(time, step, end))
}

/// Refuses a step of an instance for scheduled execution.
///
/// # Safety
/// As for all functions of [`Vtable`].
#[cold]
unsafe extern "C" fn refuse_step(pointer: Pointer, _: f64, _: f64, _: StepEnd) -> Status {
    // SAFETY: the caller's promise.
    unsafe {
        head(pointer).map_or(Status::Error, |head| call(pointer, &head.edge.do_step, |_| Ok(())))
    }
}

/// Access to Float64. A reference stands for a scalar or an element of an array (`elements`), or for a variable with
/// all its elements (`variables`).
impl<M: Model, const N: usize> HostedInstance<LaidOut<M, N>> {
    /// Whether a get or set may take the fast path: between steps, with arrays that are not NULL.
    #[inline(always)]
    fn is_fast<V>(&self, references: *const u32, values: *const V) -> bool {
        self.instance.shared.lifecycle.state == State::StepMode
            && !references.is_null()
            && !values.is_null()
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn get_elements(
        pointer: Pointer,
        references: *const u32,
        n: usize,
        values: *mut f64,
    ) -> Status {
        // SAFETY: the caller's promise; no array is NULL by the check.
        unsafe {
            let hosted = Self::at(pointer);
            if hosted.is_fast(references, values)
                && (hosted.instance.model)
                    .get_elements(from_raw_parts(references, n), from_raw_parts_mut(values, n))
            {
                return Status::Ok;
            }
            get_float64(pointer, references, n, values, n)
        }
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn set_elements(
        pointer: Pointer,
        references: *const u32,
        n: usize,
        values: *const f64,
    ) -> Status {
        // SAFETY: the caller's promise; no array is NULL by the check.
        unsafe {
            let hosted = Self::at(pointer);
            if hosted.is_fast(references, values)
                && (hosted.instance.model)
                    .set_elements(from_raw_parts(references, n), from_raw_parts(values, n))
            {
                return Status::Ok;
            }
            set_float64(pointer, references, n, values, n)
        }
    }

    /// Gets variables quickly if all are scalars. Arrays are left to another function, since its registers would have
    /// to be saved here.
    ///
    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn get_variables(
        pointer: Pointer,
        references: *const u32,
        n: usize,
        values: *mut f64,
        n_values: usize,
    ) -> Status {
        // SAFETY: the caller's promise; no array is NULL by the check.
        unsafe {
            let hosted = Self::at(pointer);
            if n == n_values
                && hosted.is_fast(references, values)
                && hosted.instance.model.get_scalars(
                    LaidOut::<M, N>::SCALARS,
                    from_raw_parts(references, n),
                    from_raw_parts_mut(values, n_values),
                )
            {
                return Status::Ok;
            }
            Self::get_arrays(pointer, references, n, values, n_values)
        }
    }

    /// Sets variables quickly if all are scalars, as [`get_variables`](Self::get_variables).
    ///
    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn set_variables(
        pointer: Pointer,
        references: *const u32,
        n: usize,
        values: *const f64,
        n_values: usize,
    ) -> Status {
        // SAFETY: the caller's promise; no array is NULL by the check.
        unsafe {
            let hosted = Self::at(pointer);
            if n == n_values
                && hosted.is_fast(references, values)
                && hosted.instance.model.set_scalars(
                    LaidOut::<M, N>::SCALARS,
                    from_raw_parts(references, n),
                    from_raw_parts(values, n_values),
                )
            {
                return Status::Ok;
            }
            Self::set_arrays(pointer, references, n, values, n_values)
        }
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn get_arrays(
        pointer: Pointer,
        references: *const u32,
        n: usize,
        values: *mut f64,
        n_values: usize,
    ) -> Status {
        // SAFETY: the caller's promise; no array is NULL by the check.
        unsafe {
            let hosted = Self::at(pointer);
            if hosted.is_fast(references, values)
                && hosted
                    .instance
                    .model
                    .get_arrays(from_raw_parts(references, n), from_raw_parts_mut(values, n_values))
            {
                return Status::Ok;
            }
            get_float64(pointer, references, n, values, n_values)
        }
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[inline(never)]
    unsafe extern "C" fn set_arrays(
        pointer: Pointer,
        references: *const u32,
        n: usize,
        values: *const f64,
        n_values: usize,
    ) -> Status {
        // SAFETY: the caller's promise; no array is NULL by the check.
        unsafe {
            let hosted = Self::at(pointer);
            if hosted.is_fast(references, values)
                && (hosted.instance.model)
                    .set_arrays(from_raw_parts(references, n), from_raw_parts(values, n_values))
            {
                return Status::Ok;
            }
            set_float64(pointer, references, n, values, n_values)
        }
    }

    /// # Safety
    /// As for all functions of [`Vtable`].
    #[cfg(all(target_arch = "wasm32", not(feature = "sources")))]
    unsafe fn count_elements(pointer: Pointer, references: *const u32, n: usize) -> usize {
        // SAFETY: the caller's promise.
        let (hosted, references) = unsafe { (Self::at(pointer), slice(references, n)) };
        let model: &mut dyn AnyModel = &mut hosted.instance.model;
        let references = references.unwrap_or_default().iter();
        references.map(|&reference| model.elements_in_use(reference).unwrap_or(1)).sum()
    }
}

/// Gets Float64 in the cases that are not fast.
///
/// # Safety
/// As for all functions of [`Vtable`].
#[cold]
#[inline(never)]
unsafe extern "C" fn get_float64(
    pointer: Pointer,
    references: *const u32,
    n: usize,
    values: *mut f64,
    n_values: usize,
) -> Status {
    // SAFETY: the caller's promise.
    unsafe {
        let Some(Head { edge: Edge { get_float64, .. }, .. }) = head(pointer) else {
            return Status::Error;
        };
        match slice(references, n).zip(slice_mut(values, n_values)) {
            Some((references, values)) => {
                call(pointer, get_float64, |instance| instance.get_float64(references, values))
            }
            None => refuse(pointer, get_float64, NULL_ARRAY),
        }
    }
}

/// Sets Float64 in the cases that are not fast.
///
/// # Safety
/// As for all functions of [`Vtable`].
#[cold]
#[inline(never)]
unsafe extern "C" fn set_float64(
    pointer: Pointer,
    references: *const u32,
    n: usize,
    values: *const f64,
    n_values: usize,
) -> Status {
    // SAFETY: the caller's promise.
    unsafe {
        let Some(Head { edge: Edge { set_float64, .. }, .. }) = head(pointer) else {
            return Status::Error;
        };
        match slice(references, n).zip(slice(values, n_values)) {
            Some((references, values)) => {
                call(pointer, set_float64, |instance| instance.set_float64(references, values))
            }
            None => refuse(pointer, set_float64, NULL_ARRAY),
        }
    }
}

/// Access to the Float64 of a model, by the tables of its layout.
impl<M: Model, const N: usize> LaidOut<M, N> {
    /// As [`get_scalars`](Self::get_scalars) for scalars and elements of arrays in use, but writes nothing if it returns
    /// false.
    #[inline(always)]
    pub(crate) fn get_elements(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        if Self::IS_LARGE {
            return large::get(self, Part::Element, references, values);
        }
        let is_real = |&reference: &u32| {
            let place = Self::ELEMENTS.get(reference as usize);
            place.is_some_and(|place| place.offset != Float64Place::NONE)
        };
        !self.has_fewer_elements()
            && (references.len() == 1 || references.iter().all(is_real))
            && self.get_scalars(Self::ELEMENTS, references, values)
    }

    /// As [`set_scalars`](Self::set_scalars) for scalars and elements of arrays in use.
    #[inline(always)]
    pub(crate) fn set_elements(&mut self, references: &[u32], values: &[f64]) -> bool {
        if Self::IS_LARGE {
            return large::set(self, Part::Element, references, values);
        }
        !self.has_fewer_elements() && self.set_scalars(Self::ELEMENTS, references, values)
    }

    /// Whether a variant uses fewer elements of an array than `ELEMENTS` assumes.
    #[inline(always)]
    fn has_fewer_elements(&self) -> bool {
        Self::HAS_STRUCTURAL_PARAMETERS && self.has_fewer_elements
    }

    /// Gets Float64 by a table of places. Returns false if a reference has no place; some values may have been
    /// written.
    #[inline(always)]
    pub(crate) fn get_scalars(
        &mut self,
        places: &'static [Float64Place; N],
        references: &[u32],
        values: &mut [f64],
    ) -> bool {
        let mut get = |(&reference, value): (&u32, &mut f64)| match places.get(reference as usize) {
            Some(&Float64Place { offset, .. }) if offset != Float64Place::NONE => {
                // SAFETY: the reference belongs to a Float64, by the check.
                *value = unsafe { *float64_at(self.memory(), offset) };
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

    /// Sets Float64 by a table of places. Returns false and writes nothing if a variable or value is not allowed
    /// between steps.
    #[inline(always)]
    pub(crate) fn set_scalars(
        &mut self,
        places: &'static [Float64Place; N],
        references: &[u32],
        values: &[f64],
    ) -> bool {
        // The range is empty unless the variable is a Float64 that may be set.
        let is_allowed = |(&reference, value): (&u32, &f64)| {
            (places.get(reference as usize))
                .is_some_and(|place| place.min <= *value && *value <= place.max)
        };
        // SAFETY: the reference belongs to a Float64, by the check.
        let mut set = |(&reference, &value): (&u32, &f64)| unsafe {
            *float64_at(self.memory(), places.get_unchecked(reference as usize).offset) = value;
        };
        // A single value without a loop, as for getting.
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

    /// As [`get_scalars`](Self::get_scalars), where a reference stands for a variable with all its
    /// elements. Some values may have been written if it returns false: they are undefined after an error,
    /// and a loop that checks all references before would take 5 ns.
    #[inline(always)]
    pub(crate) fn get_arrays(&mut self, references: &[u32], values: &mut [f64]) -> bool {
        if Self::IS_LARGE {
            return large::get(self, Part::Variable, references, values);
        }
        let mut rest = values;
        for &reference in references {
            match Self::VARIABLES.get(reference as usize) {
                Some(place) if place.offset != Float64Place::NONE => {}
                _ => return false,
            }
            // SAFETY: the reference belongs to a Float64, by the check.
            let array = unsafe { self.float64s(reference) };
            let Some((values, others)) = rest.split_at_mut_checked(array.len()) else {
                return false;
            };
            copy_numbers(array, values);
            rest = others;
        }
        rest.is_empty()
    }

    /// As [`set_elements`](Self::set_elements), where a reference stands for a variable with all its
    /// elements.
    #[inline(always)]
    pub(crate) fn set_arrays(&mut self, references: &[u32], values: &[f64]) -> bool {
        if Self::IS_LARGE {
            return large::set(self, Part::Variable, references, values);
        }
        let mut rest = values;
        for &reference in references {
            let Some(place) = Self::VARIABLES.get(reference as usize) else {
                return false;
            };
            let length = self.length(&Self::ARRAYS[reference as usize]);
            let Some((values, others)) = rest.split_at_checked(length) else {
                return false;
            };
            // The range is empty unless the variable is a Float64 that may be set.
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
            // SAFETY: the reference belongs to a Float64, by the check.
            let array = unsafe { self.float64s(reference) };
            let Some((values, others)) = rest.split_at_checked(array.len()) else {
                return false;
            };
            copy_numbers(values, array);
            rest = others;
        }
        true
    }

    /// The number of elements in use.
    #[inline(always)]
    fn length(&mut self, array: &Extent) -> usize {
        match Self::HAS_STRUCTURAL_PARAMETERS {
            // SAFETY: the entry is one of this model.
            true => unsafe { elements_in_use(self.memory(), array) },
            false => array.count as usize,
        }
    }

    /// The elements in use of the variable with the given reference.
    ///
    /// # Safety
    /// The reference belongs to a Float64 in the table of variables.
    #[inline(always)]
    unsafe fn float64s(&mut self, reference: u32) -> &mut [f64] {
        // SAFETY: the caller's promise; `Variables` promises an array of `f64` at this offset.
        unsafe {
            let place = Self::VARIABLES.get_unchecked(reference as usize);
            let length = self.length(Self::ARRAYS.get_unchecked(reference as usize));
            std::slice::from_raw_parts_mut(float64_at(self.memory(), place.offset), length)
        }
    }
}

/// Copies numbers to a slice of the same length. Most are one or a few, for which a call of `memcpy` would
/// take longer.
#[inline(always)]
fn copy_numbers(from: &[f64], to: &mut [f64]) {
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
