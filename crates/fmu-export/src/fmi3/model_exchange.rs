//! Functions of model exchange (FMI 3.0.2, section 3.2).

use super::{
    NULL_ARRAY, NULL_RESULT, calls, fmi3Boolean, fmi3False, fmi3Float64, fmi3Instance, fmi3Status,
    slice, slice_mut, variable, with,
};
use crate::slave::Numbers;

/// `fmi3CompletedIntegratorStep`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3CompletedIntegratorStep(
    instance: fmi3Instance,
    _no_set_fmu_state_prior_to_current_point: fmi3Boolean,
    enter_event_mode: *mut fmi3Boolean,
    terminate_simulation: *mut fmi3Boolean,
) -> fmi3Status {
    let call = &calls::COMPLETED_INTEGRATOR_STEP;
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |component| {
            let results = variable(enter_event_mode).zip(variable(terminate_simulation));
            let Some((event, terminate)) = results else {
                return component.refuse(call.name, NULL_RESULT);
            };
            component.call(call, |_| {
                (*event, *terminate) = (fmi3False, fmi3False);
                Ok(())
            })
        })
    }
}

/// `fmi3SetTime`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetTime(instance: fmi3Instance, time: fmi3Float64) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |component| {
            component.set_time(&calls::SET_TIME, time)
        })
    }
}

/// `fmi3SetContinuousStates`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetContinuousStates(
    instance: fmi3Instance,
    states: *const fmi3Float64,
    n: usize,
) -> fmi3Status {
    let call = &calls::SET_CONTINUOUS_STATES;
    // SAFETY: the caller's promise: `n` elements, or NULL.
    unsafe {
        with(instance, |component| match slice(states, n) {
            Some(states) => component.set_states(call, states),
            None => component.refuse(call.name, NULL_ARRAY),
        })
    }
}

macro_rules! numbers {
    ($($function:ident = $which:ident($call:ident);)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(
                instance: fmi3Instance,
                values: *mut fmi3Float64,
                n: usize,
            ) -> fmi3Status {
                let call = &calls::$call;
                // SAFETY: the caller's promise: `n` elements, or NULL.
                unsafe {
                    with(instance, |component| match slice_mut(values, n) {
                        Some(values) => component.read(call, Numbers::$which, values),
                        None => component.refuse(call.name, NULL_ARRAY),
                    })
                }
            }
        )*
    };
}

numbers! {
    fmi3GetContinuousStateDerivatives = Derivatives(GET_DERIVATIVES);
    fmi3GetEventIndicators = EventIndicators(GET_EVENT_INDICATORS);
    fmi3GetContinuousStates = States(GET_CONTINUOUS_STATES);
    fmi3GetNominalsOfContinuousStates = Nominals(GET_NOMINALS);
}
