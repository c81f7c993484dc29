//! Reading and writing variables (FMI 2.0.4, section 2.1.7).

use super::{
    NULL_ARRAY, fmi2Boolean, fmi2Component, fmi2Integer, fmi2Real, fmi2Status, fmi2String,
    fmi2ValueReference, slice, slice_mut, with,
};
use crate::phase::{self, Call};
use crate::values::{Boolean, Value};

/// # Safety
/// As [`with`]; `references` and `values` are NULL or hold `n` elements.
unsafe fn get<V: Value>(
    call: &Call,
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *mut V,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        let arrays = slice(references, n).zip(slice_mut(values, n));
        with(c, |component| match arrays {
            Some((references, values)) => component.get(call, references, values),
            None => component.refuse(call.name, NULL_ARRAY),
        })
    }
}

/// # Safety
/// As [`with`]; `references` and `values` are NULL or hold `n` elements.
unsafe fn set<V: Value>(
    call: &Call,
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    values: *const V,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        let arrays = slice(references, n).zip(slice(values, n));
        with(c, |component| match arrays {
            Some((references, values)) => component.set(call, references, values),
            None => component.refuse(call.name, NULL_ARRAY),
        })
    }
}

/// No variable is a String, so the values are not looked at.
///
/// # Safety
/// As [`with`]; `references` is NULL or holds `n` elements.
unsafe fn strings(
    call: &Call,
    c: fmi2Component,
    references: *const fmi2ValueReference,
    n: usize,
    _values: *const fmi2String,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        let references = slice(references, n);
        with(c, |component| match references {
            Some(references) => component.strings(call, references),
            None => component.refuse(call.name, NULL_ARRAY),
        })
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
                unsafe { $access$(::<$value>)?(&phase::$call, c, references, n, values.cast()) }
            }
        )*
    };
}

entry_points! {
    fmi2GetReal(*mut fmi2Real) = get::<fmi2Real>(GET_REAL);
    fmi2GetInteger(*mut fmi2Integer) = get::<fmi2Integer>(GET_INTEGER);
    fmi2GetBoolean(*mut fmi2Boolean) = get::<Boolean>(GET_BOOLEAN);
    fmi2GetString(*mut fmi2String) = strings(GET_STRING);
    fmi2SetReal(*const fmi2Real) = set::<fmi2Real>(SET_REAL);
    fmi2SetInteger(*const fmi2Integer) = set::<fmi2Integer>(SET_INTEGER);
    fmi2SetBoolean(*const fmi2Boolean) = set::<Boolean>(SET_BOOLEAN);
    fmi2SetString(*const fmi2String) = strings(SET_STRING);
}
