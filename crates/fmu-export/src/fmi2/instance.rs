//! The type behind the host's pointer, and the three functions that a host calls at every step.
//!
//! These functions are generic over the model, so that the compiler inlines its step and variable
//! access: an entry point is a jump to the function of its model with the arguments unchanged. They
//! implement the fast path between steps, and leave everything else to the [`Component`], which
//! checks thoroughly and reports errors.

#[cfg(target_arch = "x86_64")]
use std::arch::asm;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice;

use super::{access, fmi2Real, fmi2Status, fmi2ValueReference};
use crate::Model;
use crate::bound::Bound;
use crate::component::{Component, Failure};
use crate::phase::{self, Call, Phase};
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

impl<M: Model, const N: usize> Instance for Component<Bound<M, N>> {
    fn component(&mut self) -> &mut Component {
        self
    }

    unsafe extern "C" fn get_reals(
        &mut self,
        references: *const fmi2ValueReference,
        n: usize,
        values: *mut fmi2Real,
    ) -> fmi2Status {
        align();
        if self.is_fast(references, n, values) {
            // SAFETY: not NULL by the check, and arrays of `n` elements by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts_mut(values, n),
                )
            };
            let done = self.try_fast(&phase::GET_REAL, |slave| {
                slave.get_reals(references, values)
            });
            if let Some(status) = done {
                return status;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { access::get(self, &phase::GET_REAL, references, n, values) }.into()
    }

    unsafe extern "C" fn set_reals(
        &mut self,
        references: *const fmi2ValueReference,
        n: usize,
        values: *const fmi2Real,
    ) -> fmi2Status {
        align();
        if self.is_fast(references, n, values) {
            // SAFETY: not NULL by the check, and arrays of `n` elements by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts(values, n),
                )
            };
            let done = self.try_fast(&phase::SET_REAL, |slave| {
                slave.set_reals(references, values)
            });
            if let Some(status) = done {
                return status;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { access::set(self, &phase::SET_REAL, references, n, values) }.into()
    }

    extern "C" fn do_step(&mut self, time: fmi2Real, step: fmi2Real) -> fmi2Status {
        align();
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
            Ok(Err(error)) => {
                let failure = Failure::of_step(error, time, step);
                self.component().fail(phase::DO_STEP.name, failure).into()
            }
            Err(panic) => {
                let component = self.component();
                component.fail_by_panic(phase::DO_STEP.name, panic).into()
            }
        }
    }
}

impl<M: Model, const N: usize> Component<Bound<M, N>> {
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

    /// Runs the fast path of a call, in which the model may panic; `None` if it does not apply.
    #[inline(always)]
    fn try_fast(
        &mut self,
        call: &Call,
        work: impl FnOnce(&mut Bound<M, N>) -> bool,
    ) -> Option<fmi2Status> {
        match catch_unwind(AssertUnwindSafe(|| work(&mut self.slave))) {
            Ok(done) => done.then_some(fmi2Status::fmi2OK),
            Err(panic) => Some(self.component().fail_by_panic(call.name, panic).into()),
        }
    }
}

/// Aligns the function to 16 bytes, which is not the default when optimizing for size. Without it, the
/// speed depends on where the linker happens to place the function.
#[inline(always)]
fn align() {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: an assembler directive that only inserts padding.
    unsafe {
        asm!(".p2align 4", options(nomem, nostack, preserves_flags));
    }
}
