//! The type behind the host's pointer, and the three functions that a host calls at every step.
//!
//! These functions are generic over the model, so that the compiler inlines its step and variable
//! access: an entry point is a jump to the function of its model with the arguments unchanged. They
//! implement the fast path between steps, and leave everything else to the [`Component`], which
//! checks thoroughly and reports errors.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice;

use super::{access, fmi2Real, fmi2Status, fmi2ValueReference};
use crate::Simulate;
use crate::bound::Bound;
use crate::component::Component;
use crate::phase::{self, Phase};
use crate::slave::Slave;

/// An instance of any model.
///
/// The functions have the C ABI and never unwind, so that an entry point can end in a jump.
pub(crate) trait Instance {
    /// The component, which handles all other calls.
    fn component(&mut self) -> &mut Component;

    /// `fmi2GetReal`
    ///
    /// # Safety
    /// `references` and `values` are NULL or hold `n` elements.
    unsafe extern "C" fn get_reals(
        &mut self,
        references: *const fmi2ValueReference,
        n: usize,
        values: *mut fmi2Real,
    ) -> fmi2Status;

    /// `fmi2SetReal`
    ///
    /// # Safety
    /// `references` and `values` are NULL or hold `n` elements.
    unsafe extern "C" fn set_reals(
        &mut self,
        references: *const fmi2ValueReference,
        n: usize,
        values: *const fmi2Real,
    ) -> fmi2Status;

    /// `fmi2DoStep`
    extern "C" fn do_step(&mut self, time: fmi2Real, step: fmi2Real) -> fmi2Status;
}

impl<M: Simulate, const N: usize> Instance for Component<Bound<M, N>> {
    fn component(&mut self) -> &mut Component {
        self
    }

    unsafe extern "C" fn get_reals(
        &mut self,
        references: *const fmi2ValueReference,
        n: usize,
        values: *mut fmi2Real,
    ) -> fmi2Status {
        if self.is_fast(references, n, values) {
            // SAFETY: not NULL by the check, and arrays of `n` elements by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts_mut(values, n),
                )
            };
            if self.slave.get_reals(references, values) {
                return fmi2Status::fmi2OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { get_slowly(self, references, n, values) }
    }

    unsafe extern "C" fn set_reals(
        &mut self,
        references: *const fmi2ValueReference,
        n: usize,
        values: *const fmi2Real,
    ) -> fmi2Status {
        if self.is_fast(references, n, values) {
            // SAFETY: not NULL by the check, and arrays of `n` elements by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts(values, n),
                )
            };
            if self.slave.set_reals(references, values) {
                return fmi2Status::fmi2OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { set_slowly(self, references, n, values) }
    }

    extern "C" fn do_step(&mut self, time: fmi2Real, step: fmi2Real) -> fmi2Status {
        if !self.lifecycle.is_next_step(time, step)
            && let Some(outcome) = self.component().refuse_step(time, step)
        {
            return outcome.into();
        }
        let taken = catch_unwind(AssertUnwindSafe(|| {
            self.slave.step(time, step)?;
            if Bound::<M, N>::HAS_INPUT_DERIVATIVES && self.lifecycle.has_input_derivatives {
                self.slave.clear_input_derivatives();
                self.lifecycle.has_input_derivatives = false;
            }
            Ok(())
        }));
        match taken {
            Ok(Ok(())) => {
                self.lifecycle.time = Some(time + step);
                fmi2Status::fmi2OK
            }
            Ok(Err(error)) => self.component().fail_step(error, time, step).into(),
            Err(panic) => {
                let component = self.component();
                component.fail_by_panic(phase::DO_STEP.name, panic).into()
            }
        }
    }
}

/// # Safety
/// As [`Instance::get_reals`].
#[cold]
#[inline(never)]
unsafe fn get_slowly(
    component: &mut Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *mut fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe { access::get(component, &phase::GET_REAL, references, n, values) }.into()
}

/// # Safety
/// As [`Instance::set_reals`].
#[cold]
#[inline(never)]
unsafe fn set_slowly(
    component: &mut Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *const fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe { access::set(component, &phase::SET_REAL, references, n, values) }.into()
}

impl<M: Simulate, const N: usize> Component<Bound<M, N>> {
    /// Whether a get or set may take the fast path: between steps, with arrays that are not empty.
    #[inline(always)]
    fn is_fast<V>(
        &self,
        references: *const fmi2ValueReference,
        n: usize,
        values: *const V,
    ) -> bool {
        self.lifecycle.phase == Phase::StepComplete
            && n != 0
            && !references.is_null()
            && !values.is_null()
    }
}
