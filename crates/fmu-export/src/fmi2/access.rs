//! Reading and writing variables (FMI 2.0.4, section 2.1.7).

use super::{
    NULL_ARRAY, fmi2Boolean, fmi2Component, fmi2Integer, fmi2Real, fmi2Status, fmi2String,
    fmi2ValueReference, instance, slice, slice_mut, with,
};
use crate::component::{Component, Outcome};
use crate::phase::{self, Call};
use crate::values::{Boolean, Value};

/// `fmi2GetReal`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetReal(
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *mut fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        match instance(c) {
            Some(instance) => instance.get_reals(references, n, values),
            None => fmi2Status::fmi2Error,
        }
    }
}

/// `fmi2SetReal`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetReal(
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *const fmi2Real,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        match instance(c) {
            Some(instance) => instance.set_reals(references, n, values),
            None => fmi2Status::fmi2Error,
        }
    }
}

/// # Safety
/// `references` and `values` are NULL or hold `n` elements.
pub(super) unsafe fn get<V: Value>(
    component: &mut Component,
    call: &Call,
    references: *const fmi2ValueReference,
    n: usize,
    values: *mut V,
) -> Outcome {
    // SAFETY: the caller's promise.
    match unsafe { slice(references, n).zip(slice_mut(values, n)) } {
        Some((references, values)) => component.get(call, references, values),
        None => component.refuse(call.name, NULL_ARRAY),
    }
}

/// # Safety
/// `references` and `values` are NULL or hold `n` elements.
pub(super) unsafe fn set<V: Value>(
    component: &mut Component,
    call: &Call,
    references: *const fmi2ValueReference,
    n: usize,
    values: *const V,
) -> Outcome {
    // SAFETY: the caller's promise.
    match unsafe { slice(references, n).zip(slice(values, n)) } {
        Some((references, values)) => component.set(call, references, values),
        None => component.refuse(call.name, NULL_ARRAY),
    }
}

/// Rejects access to Strings. No variable is a String, so the values are not used.
///
/// # Safety
/// `references` is NULL or holds `n` elements.
unsafe fn strings(
    component: &mut Component,
    call: &Call,
    references: *const fmi2ValueReference,
    n: usize,
    _values: *const fmi2String,
) -> Outcome {
    // SAFETY: the caller's promise.
    match unsafe { slice(references, n) } {
        Some(references) => component.strings(call, references),
        None => component.refuse(call.name, NULL_ARRAY),
    }
}

macro_rules! entry_points {
    ($($function:ident($type:ty) = $access:ident$(::<$value:ty>)?($call:ident);)*) => {
        $(
            #[doc = concat!("`", stringify!($function), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $function(
                c: fmi2Component,
                references: *const fmi2ValueReference,
                n: usize,
                values: $type,
            ) -> fmi2Status {
                // SAFETY: the caller's promise; `Boolean` is a transparent `fmi2Boolean`.
                unsafe {
                    with(c, |component| {
                        $access$(::<$value>)?(component, &phase::$call, references, n, values.cast())
                    })
                }
            }
        )*
    };
}

entry_points! {
    fmi2GetInteger(*mut fmi2Integer) = get::<fmi2Integer>(GET_INTEGER);
    fmi2GetBoolean(*mut fmi2Boolean) = get::<Boolean>(GET_BOOLEAN);
    fmi2GetString(*mut fmi2String) = strings(GET_STRING);
    fmi2SetInteger(*const fmi2Integer) = set::<fmi2Integer>(SET_INTEGER);
    fmi2SetBoolean(*const fmi2Boolean) = set::<Boolean>(SET_BOOLEAN);
    fmi2SetString(*const fmi2String) = strings(SET_STRING);
}
