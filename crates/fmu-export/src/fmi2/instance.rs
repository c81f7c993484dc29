//! The three functions that a host calls at every step.
//!
//! These functions are generic over the model, so that the compiler inlines its step and variable
//! access: an entry point is a jump to the function of its model with the arguments unchanged. They
//! implement the fast path between steps, and leave everything else to the [`Component`], which
//! checks thoroughly and reports errors.

use std::slice;

use super::calls::{DO_STEP, GET_REAL, SET_REAL};
use super::{access, fmi2Component, fmi2Real, fmi2Status, fmi2ValueReference};
use crate::Model;
use crate::bound::Bound;
use crate::component::Component;
use crate::instance::{Common, Instance};
use crate::values::fmi2::Real;

/// The functions that depend on the model. The first argument is the host's pointer to an instance of
/// this model, which is not used concurrently; the others are those of the standard. They never unwind.
pub(super) struct Functions {
    pub(super) common: Common,
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
}

impl crate::instance::Functions for Functions {
    type Options = ();

    fn common(&self) -> &Common {
        &self.common
    }
}

/// Moves a component to the heap and returns the host's pointer to it.
pub(crate) fn create<M: Model, const N: usize>(component: Component<Bound<M, N>>) -> fmi2Component {
    Instance::create(&Instance::<Functions, M, N>::FUNCTIONS, (), component)
}

impl<M: Model, const N: usize> Instance<Functions, M, N> {
    const FUNCTIONS: Functions = Functions {
        common: Self::COMMON,
        get_reals: Self::get_reals,
        set_reals: Self::set_reals,
        do_step: Self::do_step,
    };

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
        component.take_step(&DO_STEP, time, step).into()
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
    let call = &GET_REAL;
    // SAFETY: the caller's promise; `Real` is a transparent `fmi2Real`.
    unsafe {
        super::with(c, |component| {
            access::get::<Real>(component, call, references, n, values.cast())
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
    let call = &SET_REAL;
    // SAFETY: the caller's promise; `Real` is a transparent `fmi2Real`.
    unsafe {
        super::with(c, |component| {
            access::set::<Real>(component, call, references, n, values.cast())
        })
    }
}
