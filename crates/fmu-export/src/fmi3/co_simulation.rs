//! Functions of co-simulation (FMI 3.0.2, section 4.2).

use super::instance::Functions;
use super::{
    NULL_ARRAY, access, calls, fmi3Boolean, fmi3Float64, fmi3Instance, fmi3Int32, fmi3Status,
    fmi3ValueReference, slice, slice_mut, with,
};
use crate::instance::functions;

/// `fmi3DoStep`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3DoStep(
    instance: fmi3Instance,
    current_communication_point: fmi3Float64,
    communication_step_size: fmi3Float64,
    no_set_fmu_state_prior_to_current_point: fmi3Boolean,
    event_handling_needed: *mut fmi3Boolean,
    terminate_simulation: *mut fmi3Boolean,
    early_return: *mut fmi3Boolean,
    last_successful_time: *mut fmi3Float64,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        match functions::<Functions>(instance) {
            Some(functions) => (functions.do_step)(
                instance,
                current_communication_point,
                communication_step_size,
                no_set_fmu_state_prior_to_current_point,
                event_handling_needed,
                terminate_simulation,
                early_return,
                last_successful_time,
            ),
            None => fmi3Status::fmi3Error,
        }
    }
}

/// `fmi3GetOutputDerivatives`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3GetOutputDerivatives(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    orders: *const fmi3Int32,
    values: *mut fmi3Float64,
    n_values: usize,
) -> fmi3Status {
    let call = &calls::OUTPUT_DERIVATIVES;
    // SAFETY: the caller's promise: arrays of these lengths, or NULL.
    unsafe {
        let allowed = access::intermediate_variables(instance);
        let arrays = (
            slice(references, n),
            slice(orders, n),
            slice_mut(values, n_values),
        );
        with(instance, |component| match arrays {
            (Some(references), Some(orders), Some(values)) => {
                component.output_array_derivatives(call, references, orders, values, allowed)
            }
            _ => component.refuse(call.name, NULL_ARRAY),
        })
    }
}
