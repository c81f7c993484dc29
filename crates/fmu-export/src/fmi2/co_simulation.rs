//! Functions of co-simulation (FMI 2.0.5, section 4.2).

use super::{
    calls, fmi2Boolean, fmi2Component, fmi2False, fmi2LastSuccessfulTime, fmi2Real, fmi2Status,
    fmi2StatusKind, fmi2Terminated, instance::Functions, with,
};
use crate::component::{Component, Failure};
use crate::instance::functions;
use crate::phase::Call;

/// `fmi2DoStep`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DoStep(
    c: fmi2Component,
    current_communication_point: fmi2Real,
    communication_step_size: fmi2Real,
    _no_set_fmu_state_prior_to_current_point: fmi2Boolean,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        match functions::<Functions>(c) {
            Some(functions) => {
                (functions.do_step)(c, current_communication_point, communication_step_size)
            }
            None => fmi2Status::fmi2Error,
        }
    }
}

/// Returns a status value, if it is one that a synchronous slave has.
///
/// # Safety
/// As [`with`], and `value` is NULL or writable.
unsafe fn answer<T>(
    call: &Call,
    c: fmi2Component,
    value: *mut T,
    of: impl FnOnce(&Component) -> Option<T>,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.call(call, |component| {
                let Some(answer) = of(component) else {
                    return Err(Failure::Refused(ASYNCHRONOUS.into()));
                };
                *value
                    .as_mut()
                    .ok_or_else(|| Failure::Refused(NULL_VALUE.into()))? = answer;
                Ok(())
            })
        })
    }
}

const NULL_VALUE: &str = "the pointer to the value is NULL";
const ASYNCHRONOUS: &str =
    "this kind of status exists for asynchronous steps only, which the slave does not support";

/// `fmi2GetRealStatus`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealStatus(
    c: fmi2Component,
    kind: fmi2StatusKind,
    value: *mut fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        answer(&calls::REAL_STATUS, c, value, |component| {
            (kind == fmi2LastSuccessfulTime).then(|| component.lifecycle.now())
        })
    }
}

/// `fmi2GetBooleanStatus`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetBooleanStatus(
    c: fmi2Component,
    kind: fmi2StatusKind,
    value: *mut fmi2Boolean,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        answer(&calls::BOOLEAN_STATUS, c, value, |_| {
            (kind == fmi2Terminated).then_some(fmi2False)
        })
    }
}
