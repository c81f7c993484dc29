//! Directional derivatives (FMI 2.0.5, section 2.1.9), and time derivatives of inputs and outputs
//! (section 4.2.1).

use super::{
    NULL_ARRAY, calls, fmi2Component, fmi2Integer, fmi2Real, fmi2Status, fmi2ValueReference, slice,
    slice_mut, with,
};
use crate::values::FmiType;
use crate::values::fmi2::Real;

/// `fmi2GetDirectionalDerivative`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetDirectionalDerivative(
    c: fmi2Component,
    unknowns: *const fmi2ValueReference,
    n_unknowns: usize,
    knowns: *const fmi2ValueReference,
    n_knowns: usize,
    direction: *const fmi2Real,
    derivatives: *mut fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise: arrays of `n_unknowns` and `n_knowns` elements, or NULL.
    unsafe {
        let unknowns = slice(unknowns, n_unknowns).zip(slice_mut(derivatives, n_unknowns));
        let knowns = slice(knowns, n_knowns).zip(slice(direction, n_knowns));
        with(c, |component| match (unknowns, knowns) {
            (Some((unknowns, derivatives)), Some((knowns, direction))) => component
                .directional_derivative(
                    &calls::DIRECTIONAL_DERIVATIVE,
                    <Real as FmiType>::ACCESS,
                    unknowns,
                    knowns,
                    direction,
                    derivatives,
                ),
            _ => component.refuse(calls::DIRECTIONAL_DERIVATIVE.name, NULL_ARRAY),
        })
    }
}

/// `fmi2SetRealInputDerivatives`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetRealInputDerivatives(
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    orders: *const fmi2Integer,
    values: *const fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise: arrays of `n` elements, or NULL.
    unsafe {
        let arrays = (slice(references, n), slice(orders, n), slice(values, n));
        with(c, |component| match arrays {
            (Some(references), Some(orders), Some(values)) => component.set_input_derivatives(
                &calls::INPUT_DERIVATIVES,
                references,
                orders,
                values,
            ),
            _ => component.refuse(calls::INPUT_DERIVATIVES.name, NULL_ARRAY),
        })
    }
}

/// `fmi2GetRealOutputDerivatives`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealOutputDerivatives(
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    orders: *const fmi2Integer,
    values: *mut fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise: arrays of `n` elements, or NULL.
    unsafe {
        let arrays = (slice(references, n), slice(orders, n), slice_mut(values, n));
        with(c, |component| match arrays {
            (Some(references), Some(orders), Some(values)) => {
                component.output_derivatives(&calls::OUTPUT_DERIVATIVES, references, orders, values)
            }
            _ => component.refuse(calls::OUTPUT_DERIVATIVES.name, NULL_ARRAY),
        })
    }
}
