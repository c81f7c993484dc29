//! What the host's pointer points to, and the three functions that a host calls at every step.
//!
//! These functions are generic over the model, so that the compiler inlines its step and variable
//! access: an entry point is a jump to the function of its model with the arguments unchanged. They
//! implement the fast path between steps, and leave everything else to the [`Component`], which
//! checks thoroughly and reports errors.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice;

use super::{access, fmi2Component, fmi2Real, fmi2Status, fmi2ValueReference};
use crate::Simulate;
use crate::bound::Bound;
use crate::component::Component;
use crate::phase::{self, Phase};
use crate::slave::Slave;

/// The functions that depend on the model. The first argument is the host's pointer to an instance of
/// this model, which is not used concurrently; the others are those of the standard. They never unwind.
pub(super) struct Functions {
    /// The component, which handles all other calls.
    pub(super) component: unsafe fn(fmi2Component) -> *mut Component,
    /// `fmi2GetReal`
    pub(super) get_reals: unsafe extern "C" fn(
        fmi2Component,
        *const fmi2ValueReference,
        usize,
        *mut fmi2Real,
    ) -> fmi2Status,
    /// `fmi2SetReal`
    pub(super) set_reals: unsafe extern "C" fn(
        fmi2Component,
        *const fmi2ValueReference,
        usize,
        *const fmi2Real,
    ) -> fmi2Status,
    /// `fmi2DoStep`
    pub(super) do_step: unsafe extern "C" fn(fmi2Component, fmi2Real, fmi2Real) -> fmi2Status,
    /// `fmi2FreeInstance`
    pub(super) free: unsafe fn(fmi2Component),
}

/// An instance of a model. The table of functions comes first, so that it can be found without knowing
/// the model.
#[repr(C)]
struct Instance<M, const N: usize> {
    functions: &'static Functions,
    component: Component<Bound<M, N>>,
}

/// Moves a component to the heap and returns the host's pointer to it.
pub(super) fn create<M: Simulate, const N: usize>(
    component: Component<Bound<M, N>>,
) -> fmi2Component {
    let functions = &Instance::<M, N>::FUNCTIONS;
    Box::into_raw(Box::new(Instance {
        functions,
        component,
    }))
    .cast()
}

/// The functions of the instance behind the host's pointer; `None` for NULL.
///
/// # Safety
/// `c` is NULL or came from [`create`], and is not freed.
#[inline(always)]
pub(super) unsafe fn functions(c: fmi2Component) -> Option<&'static Functions> {
    // SAFETY: every instance begins with a pointer to its functions.
    unsafe { c.cast::<&'static Functions>().as_ref().copied() }
}

/// The component behind the host's pointer; `None` for NULL.
///
/// # Safety
/// As [`functions`], and the instance is not used otherwise during the lifetime of the component.
#[inline(always)]
pub(super) unsafe fn component<'a>(c: fmi2Component) -> Option<&'a mut Component> {
    // SAFETY: the caller's promise; the functions are those of the instance.
    unsafe { functions(c).map(|functions| &mut *(functions.component)(c)) }
}

impl<M: Simulate, const N: usize> Instance<M, N> {
    const FUNCTIONS: Functions = Functions {
        component: Self::component,
        get_reals: Self::get_reals,
        set_reals: Self::set_reals,
        do_step: Self::do_step,
        free: Self::free,
    };

    /// # Safety
    /// As for all [`Functions`].
    #[inline(always)]
    unsafe fn of<'a>(c: fmi2Component) -> &'a mut Component<Bound<M, N>> {
        // SAFETY: the pointer is that of an instance of this model.
        unsafe { &mut (*c.cast::<Self>()).component }
    }

    /// # Safety
    /// As for all [`Functions`].
    unsafe fn component(c: fmi2Component) -> *mut Component {
        // SAFETY: the caller's promise.
        unsafe { Self::of(c) }
    }

    /// # Safety
    /// As for all [`Functions`].
    unsafe fn free(c: fmi2Component) {
        // SAFETY: `create` made the pointer from a box.
        drop(unsafe { Box::from_raw(c.cast::<Self>()) });
    }

    /// # Safety
    /// As for all [`Functions`].
    unsafe extern "C" fn get_reals(
        c: fmi2Component,
        references: *const fmi2ValueReference,
        n: usize,
        values: *mut fmi2Real,
    ) -> fmi2Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(c) };
        if component.is_fast(references, values) {
            // SAFETY: not NULL by the check, and arrays of `n` elements by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts_mut(values, n),
                )
            };
            if component.slave.get_reals(references, values) {
                return fmi2Status::fmi2OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { get_slowly(c, references, n, values) }
    }

    /// # Safety
    /// As for all [`Functions`].
    unsafe extern "C" fn set_reals(
        c: fmi2Component,
        references: *const fmi2ValueReference,
        n: usize,
        values: *const fmi2Real,
    ) -> fmi2Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(c) };
        if component.is_fast(references, values) {
            // SAFETY: not NULL by the check, and arrays of `n` elements by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts(values, n),
                )
            };
            if component.slave.set_reals(references, values) {
                return fmi2Status::fmi2OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { set_slowly(c, references, n, values) }
    }

    /// # Safety
    /// As for all [`Functions`].
    unsafe extern "C" fn do_step(c: fmi2Component, time: fmi2Real, step: fmi2Real) -> fmi2Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(c) };
        if !component.lifecycle.is_next_step(time, step)
            && let Some(outcome) = component.shared().refuse_step(time, step)
        {
            return outcome.into();
        }
        let taken = catch_unwind(AssertUnwindSafe(|| {
            component.slave.step(time, step)?;
            if Bound::<M, N>::HAS_INPUT_DERIVATIVES && component.lifecycle.has_input_derivatives {
                component.slave.clear_input_derivatives();
                component.lifecycle.has_input_derivatives = false;
            }
            Ok(())
        }));
        match taken {
            Ok(Ok(())) => {
                component.lifecycle.time = time + step;
                fmi2Status::fmi2OK
            }
            Ok(Err(error)) => component.shared().fail_step(error, time, step).into(),
            Err(panic) => {
                let component = component.shared();
                component.fail_by_panic(phase::DO_STEP.name, panic).into()
            }
        }
    }
}

/// `fmi2GetReal` for the cases that are not fast.
///
/// # Safety
/// As for all [`Functions`].
#[cold]
#[inline(never)]
unsafe extern "C" fn get_slowly(
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *mut fmi2Real,
) -> fmi2Status {
    let call = &phase::GET_REAL;
    // SAFETY: the caller's promise.
    unsafe {
        super::with(c, |component| {
            access::get(component, call, references, n, values)
        })
    }
}

/// `fmi2SetReal` for the cases that are not fast.
///
/// # Safety
/// As for all [`Functions`].
#[cold]
#[inline(never)]
unsafe extern "C" fn set_slowly(
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *const fmi2Real,
) -> fmi2Status {
    let call = &phase::SET_REAL;
    // SAFETY: the caller's promise.
    unsafe {
        super::with(c, |component| {
            access::set(component, call, references, n, values)
        })
    }
}

impl<M: Simulate, const N: usize> Component<Bound<M, N>> {
    /// The component without its type.
    fn shared(&mut self) -> &mut Component {
        self
    }

    /// Whether a get or set may take the fast path: between steps, with arrays that are not NULL.
    #[inline(always)]
    fn is_fast<V>(&self, references: *const fmi2ValueReference, values: *const V) -> bool {
        self.lifecycle.phase == Phase::StepComplete && !references.is_null() && !values.is_null()
    }
}
