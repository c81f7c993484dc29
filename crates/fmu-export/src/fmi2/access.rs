//! Reading and writing variables (FMI 2.0.5, section 2.1.7).

use super::{
    NULL_ARRAY, calls, fmi2Boolean, fmi2Component, fmi2Integer, fmi2Real, fmi2Status, fmi2String,
    fmi2ValueReference, instance::Functions, slice, slice_mut, text, with,
};
use crate::component::{Component, Outcome};
use crate::instance::functions;
use crate::phase::Call;
use crate::values::fmi2::{Boolean, Integer, Text};
use crate::values::{FmiType, Given};

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
        match functions::<Functions>(c) {
            Some(functions) => (functions.get_reals)(c, references, n, values),
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
        match functions::<Functions>(c) {
            Some(functions) => (functions.set_reals)(c, references, n, values),
            None => fmi2Status::fmi2Error,
        }
    }
}

/// # Safety
/// `references` and `values` are NULL or hold `n` elements.
pub(super) unsafe fn get<T: FmiType>(
    component: &mut Component,
    call: &Call,
    references: *const fmi2ValueReference,
    n: usize,
    values: *mut T,
) -> Outcome {
    // SAFETY: the caller's promise.
    match unsafe { slice(references, n).zip(slice_mut(values, n)) } {
        Some((references, values)) => component.get(call, references, values),
        None => component.refuse(call.name, NULL_ARRAY),
    }
}

/// # Safety
/// `references` and `values` are NULL or hold `n` elements.
pub(super) unsafe fn set<'a, T: Into<Given<'a>> + Copy + 'a>(
    component: &mut Component,
    call: &Call,
    references: *const fmi2ValueReference,
    n: usize,
    values: *const T,
) -> Outcome {
    // SAFETY: the caller's promise.
    match unsafe { slice(references, n).zip(slice(values, n)) } {
        Some((references, values)) => component.set(call, references, values),
        None => component.refuse(call.name, NULL_ARRAY),
    }
}

/// Hands out pointers to texts that live until the next call.
///
/// # Safety
/// As [`get`].
unsafe fn get_strings(
    component: &mut Component,
    call: &Call,
    references: *const fmi2ValueReference,
    n: usize,
    values: *mut fmi2String,
) -> Outcome {
    // SAFETY: the caller's promise.
    let Some((references, values)) = (unsafe { slice(references, n).zip(slice_mut(values, n)) })
    else {
        return component.refuse(call.name, NULL_ARRAY);
    };
    let outcome = component.get_texts::<Text<String>>(call, references);
    if outcome == Outcome::Ok {
        for (value, text) in values.iter_mut().zip(&component.texts) {
            *value = text.as_ptr();
        }
    }
    outcome
}

/// # Safety
/// As [`set`]; the values are NULL or zero-terminated.
unsafe fn set_strings(
    component: &mut Component,
    call: &Call,
    references: *const fmi2ValueReference,
    n: usize,
    values: *const fmi2String,
) -> Outcome {
    // SAFETY: the caller's promise.
    match unsafe { slice(references, n).zip(slice(values, n)) } {
        Some((references, values)) => {
            // SAFETY: the caller's promise.
            let texts: Vec<_> = (values.iter())
                .map(|&value| Text(unsafe { text(value) }))
                .collect();
            component.set(call, references, &texts)
        }
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
                // SAFETY: the caller's promise; the types of values are transparent.
                unsafe {
                    with(c, |component| {
                        $access$(::<$value>)?(component, &calls::$call, references, n, values.cast())
                    })
                }
            }
        )*
    };
}

entry_points! {
    fmi2GetInteger(*mut fmi2Integer) = get::<Integer>(GET_INTEGER);
    fmi2GetBoolean(*mut fmi2Boolean) = get::<Boolean>(GET_BOOLEAN);
    fmi2GetString(*mut fmi2String) = get_strings(GET_STRING);
    fmi2SetInteger(*const fmi2Integer) = set::<Integer>(SET_INTEGER);
    fmi2SetBoolean(*const fmi2Boolean) = set::<Boolean>(SET_BOOLEAN);
    fmi2SetString(*const fmi2String) = set_strings(SET_STRING);
}
