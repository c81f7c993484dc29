//! Functions of co-simulation (FMI 2.0.4, section 4.2).

use super::{
    fmi2Boolean, fmi2Component, fmi2False, fmi2LastSuccessfulTime, fmi2Real, fmi2Status,
    fmi2StatusKind, fmi2Terminated, with,
};
use crate::component::{Component, Outcome};

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
        with(c, |component| {
            component.do_step(current_communication_point, communication_step_size)
        })
    }
}

/// Answers a question about the status, if it is one that a synchronous slave can answer.
///
/// # Safety
/// As [`with`], and `value` is NULL or can be written.
unsafe fn answer<T>(
    c: fmi2Component,
    name: &str,
    value: *mut T,
    of: impl FnOnce(&mut Component) -> Option<T>,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| match (of(component), value.as_mut()) {
            (Some(answer), Some(value)) => {
                *value = answer;
                Outcome::Ok
            }
            (_, None) => component.refuse(name, "the value is NULL"),
            (None, _) => component.refuse(
                name,
                "this kind of status is that of asynchronous steps, which the slave does not take",
            ),
        })
    }
}

/// `fmi2GetRealStatus`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetRealStatus(
    c: fmi2Component,
    kind: fmi2StatusKind,
    value: *mut fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        answer(c, "fmi2GetRealStatus", value, |component| {
            (kind == fmi2LastSuccessfulTime).then(|| component.time())
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
        answer(c, "fmi2GetBooleanStatus", value, |_| {
            (kind == fmi2Terminated).then_some(fmi2False)
        })
    }
}
