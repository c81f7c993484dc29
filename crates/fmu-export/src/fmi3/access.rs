//! Reading and writing variables with all their elements (FMI 3.0.2, section 2.2.6).

use std::ffi::CStr;

use super::instance::Functions;
use super::{
    NULL_ARRAY, calls, fmi3Binary, fmi3Boolean, fmi3Float32, fmi3Float64, fmi3Instance, fmi3Int8,
    fmi3Int16, fmi3Int32, fmi3Int64, fmi3Status, fmi3String, fmi3UInt8, fmi3UInt16, fmi3UInt32,
    fmi3UInt64, fmi3ValueReference, slice, slice_mut, text, with,
};
use crate::component::Outcome;
use crate::instance::functions;
use crate::phase::Call;
use crate::values::fmi3::Boolean;
use crate::values::{FmiType, Given};

/// `fmi3GetFloat64`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3GetFloat64(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    values: *mut fmi3Float64,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        match functions::<Functions>(instance) {
            Some(functions) => (functions.get_float64)(instance, references, n, values, n_values),
            None => fmi3Status::fmi3Error,
        }
    }
}

/// `fmi3SetFloat64`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetFloat64(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    values: *const fmi3Float64,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        match functions::<Functions>(instance) {
            Some(functions) => (functions.set_float64)(instance, references, n, values, n_values),
            None => fmi3Status::fmi3Error,
        }
    }
}

/// `fmi3GetFloat64` for the cases that are not fast.
///
/// # Safety
/// As for all [`Functions`].
#[cold]
#[inline(never)]
pub(super) unsafe extern "C" fn get_float64(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    values: *mut fmi3Float64,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        get(
            instance,
            &calls::GET_FLOAT64,
            references,
            n,
            values,
            n_values,
        )
    }
}

/// `fmi3SetFloat64` for the cases that are not fast.
///
/// # Safety
/// As for all [`Functions`].
#[cold]
#[inline(never)]
pub(super) unsafe extern "C" fn set_float64(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    values: *const fmi3Float64,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        set(
            instance,
            &calls::SET_FLOAT64,
            references,
            n,
            values,
            n_values,
        )
    }
}

/// The variables that the host may access in an intermediate update.
///
/// # Safety
/// As for all [`Functions`].
pub(super) unsafe fn intermediate_variables<'a>(instance: fmi3Instance) -> &'a [u32] {
    // SAFETY: the caller's promise; the options never change.
    unsafe {
        match functions::<Functions>(instance) {
            Some(functions) => &(*(functions.options)(instance)).intermediate_variables,
            None => &[],
        }
    }
}

/// # Safety
/// As for all [`Functions`]; the arrays are NULL or have these lengths.
unsafe fn get<T: FmiType>(
    instance: fmi3Instance,
    call: &Call,
    references: *const fmi3ValueReference,
    n: usize,
    values: *mut T,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        let allowed = intermediate_variables(instance);
        let arrays = slice(references, n).zip(slice_mut(values, n_values));
        with(instance, |component| match arrays {
            Some((references, values)) => component.get_arrays(call, references, values, allowed),
            None => component.refuse(call.name, NULL_ARRAY),
        })
    }
}

/// # Safety
/// As for all [`Functions`]; the arrays are NULL or have these lengths.
unsafe fn set<'a, T: Into<Given<'a>> + Copy + 'a>(
    instance: fmi3Instance,
    call: &Call,
    references: *const fmi3ValueReference,
    n: usize,
    values: *const T,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        let arrays = slice(references, n).zip(slice(values, n_values));
        set_slices(instance, call, arrays)
    }
}

/// # Safety
/// As for all [`Functions`].
unsafe fn set_slices<'a, T: Into<Given<'a>> + Copy>(
    instance: fmi3Instance,
    call: &Call,
    arrays: Option<(&[u32], &[T])>,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        let allowed = intermediate_variables(instance);
        with(instance, |component| match arrays {
            Some((references, values)) => component.set_arrays(call, references, values, allowed),
            None => component.refuse(call.name, NULL_ARRAY),
        })
    }
}

macro_rules! entry_points {
    ($($get:ident($get_call:ident) $set:ident($set_call:ident): $type:ty as $value:ty;)*) => {
        $(
            #[doc = concat!("`", stringify!($get), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $get(
                instance: fmi3Instance,
                references: *const fmi3ValueReference,
                n: usize,
                values: *mut $type,
                n_values: usize,
            ) -> fmi3Status {
                let values = values.cast::<$value>();
                // SAFETY: the caller's promise; the types have the same representation.
                unsafe { get(instance, &calls::$get_call, references, n, values, n_values) }
            }

            #[doc = concat!("`", stringify!($set), "`")]
            #[unsafe(no_mangle)]
            pub unsafe extern "C" fn $set(
                instance: fmi3Instance,
                references: *const fmi3ValueReference,
                n: usize,
                values: *const $type,
                n_values: usize,
            ) -> fmi3Status {
                let values = values.cast::<$value>();
                // SAFETY: the caller's promise; the types have the same representation.
                unsafe { set(instance, &calls::$set_call, references, n, values, n_values) }
            }
        )*
    };
}

entry_points! {
    fmi3GetFloat32(GET_FLOAT32) fmi3SetFloat32(SET_FLOAT32): fmi3Float32 as f32;
    fmi3GetInt8(GET_INT8) fmi3SetInt8(SET_INT8): fmi3Int8 as i8;
    fmi3GetUInt8(GET_UINT8) fmi3SetUInt8(SET_UINT8): fmi3UInt8 as u8;
    fmi3GetInt16(GET_INT16) fmi3SetInt16(SET_INT16): fmi3Int16 as i16;
    fmi3GetUInt16(GET_UINT16) fmi3SetUInt16(SET_UINT16): fmi3UInt16 as u16;
    fmi3GetInt32(GET_INT32) fmi3SetInt32(SET_INT32): fmi3Int32 as i32;
    fmi3GetUInt32(GET_UINT32) fmi3SetUInt32(SET_UINT32): fmi3UInt32 as u32;
    fmi3GetInt64(GET_INT64) fmi3SetInt64(SET_INT64): fmi3Int64 as i64;
    fmi3GetUInt64(GET_UINT64) fmi3SetUInt64(SET_UINT64): fmi3UInt64 as u64;
    fmi3GetBoolean(GET_BOOLEAN) fmi3SetBoolean(SET_BOOLEAN): fmi3Boolean as Boolean;
}

/// `fmi3GetString`. The pointers are valid until the next call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3GetString(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    values: *mut fmi3String,
    n_values: usize,
) -> fmi3Status {
    let call = &calls::GET_STRING;
    // SAFETY: the caller's promise: arrays of these lengths, or NULL.
    unsafe {
        let allowed = intermediate_variables(instance);
        let arrays = slice(references, n).zip(slice_mut(values, n_values));
        with(instance, |component| {
            let Some((references, values)) = arrays else {
                return component.refuse(call.name, NULL_ARRAY);
            };
            let mut texts = vec![String::new(); values.len()];
            let outcome = component.get_arrays(call, references, &mut texts, allowed);
            if outcome == Outcome::Ok {
                for (value, text) in values.iter_mut().zip(component.keep_texts(texts)) {
                    *value = text.as_ptr();
                }
            }
            outcome
        })
    }
}

/// `fmi3SetString`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetString(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    values: *const fmi3String,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise: arrays of these lengths, or NULL; zero-terminated texts, or NULL.
    unsafe {
        let texts: Option<Vec<Option<&CStr>>> =
            slice(values, n_values).map(|values| values.iter().map(|&value| text(value)).collect());
        let arrays = slice(references, n).zip(texts.as_deref());
        set_slices(instance, &calls::SET_STRING, arrays)
    }
}

/// `fmi3GetBinary`. The pointers are valid until the next call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3GetBinary(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    sizes: *mut usize,
    values: *mut fmi3Binary,
    n_values: usize,
) -> fmi3Status {
    let call = &calls::GET_BINARY;
    // SAFETY: the caller's promise: arrays of these lengths, or NULL.
    unsafe {
        let allowed = intermediate_variables(instance);
        let values = slice_mut(sizes, n_values).zip(slice_mut(values, n_values));
        let arrays = slice(references, n).zip(values);
        with(instance, |component| {
            let Some((references, (sizes, values))) = arrays else {
                return component.refuse(call.name, NULL_ARRAY);
            };
            let mut found = vec![Vec::new(); values.len()];
            let outcome = component.get_arrays(call, references, &mut found, allowed);
            if outcome == Outcome::Ok {
                let kept = component.keep_binaries(found);
                for ((value, size), bytes) in values.iter_mut().zip(sizes).zip(kept) {
                    (*value, *size) = (bytes.as_ptr(), bytes.len());
                }
            }
            outcome
        })
    }
}

/// `fmi3SetBinary`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetBinary(
    instance: fmi3Instance,
    references: *const fmi3ValueReference,
    n: usize,
    sizes: *const usize,
    values: *const fmi3Binary,
    n_values: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise: arrays of these lengths, or NULL; values of these sizes, or NULL.
    unsafe {
        let values = slice(sizes, n_values).zip(slice(values, n_values));
        let binaries: Option<Vec<Option<&[u8]>>> = values.map(|(sizes, values)| {
            let each = sizes.iter().zip(values);
            each.map(|(&size, &value)| slice(value, size)).collect()
        });
        let arrays = slice(references, n).zip(binaries.as_deref());
        set_slices(instance, &calls::SET_BINARY, arrays)
    }
}
