//! The three functions that a host calls at every step; see `fmi2/instance.rs`.

use std::slice;

use super::calls::DO_STEP;
use super::stepping::{self, Results};
use super::{
    Options, access, fmi3Boolean, fmi3Float64, fmi3Instance, fmi3Status, fmi3ValueReference,
};
use crate::Model;
use crate::bound::Bound;
use crate::component::Component;
use crate::instance::{Common, Instance};
use crate::lifecycle::Mode;

/// The functions that depend on the model. The first argument is the host's pointer to an instance of
/// this model, which is not used concurrently; the others are those of the standard. They never unwind.
pub(super) struct Functions {
    common: Common,
    /// `fmi3GetFloat64`
    pub(super) get_float64: unsafe extern "C" fn(
        fmi3Instance,
        *const fmi3ValueReference,
        usize,
        *mut fmi3Float64,
        usize,
    ) -> fmi3Status,
    /// `fmi3SetFloat64`
    pub(super) set_float64: unsafe extern "C" fn(
        fmi3Instance,
        *const fmi3ValueReference,
        usize,
        *const fmi3Float64,
        usize,
    ) -> fmi3Status,
    /// `fmi3DoStep`
    pub(super) do_step: unsafe extern "C" fn(
        fmi3Instance,
        fmi3Float64,
        fmi3Float64,
        fmi3Boolean,
        *mut fmi3Boolean,
        *mut fmi3Boolean,
        *mut fmi3Boolean,
        *mut fmi3Float64,
    ) -> fmi3Status,
    /// What the host has said about the instance.
    pub(super) options: unsafe fn(fmi3Instance) -> *const Options,
}

impl crate::instance::Functions for Functions {
    type Options = Options;

    fn common(&self) -> &Common {
        &self.common
    }
}

/// Moves a component to the heap and returns the host's pointer to it.
pub(crate) fn create<M: Model, const N: usize>(
    options: Options,
    component: Component<Bound<M, N>>,
) -> fmi3Instance {
    type Of<M, const N: usize> = Instance<Functions, M, N>;
    let is_plain =
        component.lifecycle.mode == Mode::CoSimulation && options.intermediate_update.is_none();
    let functions = match is_plain {
        true => &Of::<M, N>::PLAIN,
        false => &Of::<M, N>::WITH_EVENTS,
    };
    Instance::create(functions, options, component)
}

impl<M: Model, const N: usize> Instance<Functions, M, N> {
    /// For a host that does not see what happens in a step.
    const PLAIN: Functions = Functions {
        common: Self::COMMON,
        get_float64: Self::get_float64,
        set_float64: Self::set_float64,
        do_step: Self::do_step,
        options: Self::options,
    };
    /// For a host that uses event mode or intermediate updates.
    const WITH_EVENTS: Functions = Functions {
        do_step: stepping::do_step,
        ..Self::PLAIN
    };

    /// Scalars; arrays are left to another function, since its registers would have to be saved here.
    ///
    /// # Safety
    /// As for all [`Functions`].
    unsafe extern "C" fn get_float64(
        instance: fmi3Instance,
        references: *const fmi3ValueReference,
        n: usize,
        values: *mut fmi3Float64,
        n_values: usize,
    ) -> fmi3Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(instance) };
        if component.is_fast(references, values) {
            // SAFETY: not NULL by the check, and arrays of these lengths by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts_mut(values, n_values),
                )
            };
            if component.slave.get_scalars(references, values) {
                return fmi3Status::fmi3OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { Self::get_float64_arrays(instance, references, n, values, n_values) }
    }

    /// # Safety
    /// As for all [`Functions`].
    #[inline(never)]
    unsafe extern "C" fn get_float64_arrays(
        instance: fmi3Instance,
        references: *const fmi3ValueReference,
        n: usize,
        values: *mut fmi3Float64,
        n_values: usize,
    ) -> fmi3Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(instance) };
        if component.is_fast(references, values) {
            // SAFETY: not NULL by the check, and arrays of these lengths by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts_mut(values, n_values),
                )
            };
            if component.slave.get_arrays(references, values) {
                return fmi3Status::fmi3OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { access::get_float64(instance, references, n, values, n_values) }
    }

    /// Scalars; arrays are left to another function, since its registers would have to be saved here.
    ///
    /// # Safety
    /// As for all [`Functions`].
    unsafe extern "C" fn set_float64(
        instance: fmi3Instance,
        references: *const fmi3ValueReference,
        n: usize,
        values: *const fmi3Float64,
        n_values: usize,
    ) -> fmi3Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(instance) };
        if component.is_fast(references, values) {
            // SAFETY: not NULL by the check, and arrays of these lengths by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts(values, n_values),
                )
            };
            if component.slave.set_scalars(references, values) {
                return fmi3Status::fmi3OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { Self::set_float64_arrays(instance, references, n, values, n_values) }
    }

    /// # Safety
    /// As for all [`Functions`].
    #[inline(never)]
    unsafe extern "C" fn set_float64_arrays(
        instance: fmi3Instance,
        references: *const fmi3ValueReference,
        n: usize,
        values: *const fmi3Float64,
        n_values: usize,
    ) -> fmi3Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(instance) };
        if component.is_fast(references, values) {
            // SAFETY: not NULL by the check, and arrays of these lengths by the caller's promise.
            let (references, values) = unsafe {
                (
                    slice::from_raw_parts(references, n),
                    slice::from_raw_parts(values, n_values),
                )
            };
            if component.slave.set_arrays(references, values) {
                return fmi3Status::fmi3OK;
            }
        }
        // SAFETY: the caller's promise.
        unsafe { access::set_float64(instance, references, n, values, n_values) }
    }

    /// # Safety
    /// As for all [`Functions`].
    unsafe extern "C" fn do_step(
        instance: fmi3Instance,
        time: fmi3Float64,
        step: fmi3Float64,
        _no_set_fmu_state_prior_to_current_point: fmi3Boolean,
        event_handling_needed: *mut fmi3Boolean,
        terminate_simulation: *mut fmi3Boolean,
        early_return: *mut fmi3Boolean,
        last_successful_time: *mut fmi3Float64,
    ) -> fmi3Status {
        // SAFETY: the caller's promise.
        let component = unsafe { Self::of(instance) };
        let outcome = component.take_step(&DO_STEP, time, step);
        let results = Results::plain(component.lifecycle.now());
        // SAFETY: the caller's promise.
        unsafe {
            results.write(
                event_handling_needed,
                terminate_simulation,
                early_return,
                last_successful_time,
            );
        }
        outcome.into()
    }
}
