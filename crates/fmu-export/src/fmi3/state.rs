//! Saving and restoring the state of an instance (FMI 3.0.2, section 2.2.10).

use super::{calls, fmi3Byte, fmi3FMUState, fmi3Instance, fmi3Status, with};
use crate::state;

/// `fmi3GetFMUState`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3GetFMUState(
    instance: fmi3Instance,
    state: *mut fmi3FMUState,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe { with(instance, |c| state::get(c, &calls::GET_FMU_STATE, state)) }
}

/// `fmi3SetFMUState`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SetFMUState(
    instance: fmi3Instance,
    state: fmi3FMUState,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe { with(instance, |c| state::set(c, &calls::SET_FMU_STATE, state)) }
}

/// `fmi3FreeFMUState`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3FreeFMUState(
    instance: fmi3Instance,
    state: *mut fmi3FMUState,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe { with(instance, |c| state::free(c, &calls::FREE_FMU_STATE, state)) }
}

/// `fmi3SerializedFMUStateSize`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SerializedFMUStateSize(
    instance: fmi3Instance,
    state: fmi3FMUState,
    size: *mut usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |c| {
            state::serialized_size(c, &calls::SERIALIZED_SIZE, state, size)
        })
    }
}

/// `fmi3SerializeFMUState`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3SerializeFMUState(
    instance: fmi3Instance,
    state: fmi3FMUState,
    buffer: *mut fmi3Byte,
    size: usize,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |c| {
            state::serialize(c, &calls::SERIALIZE, state, buffer, size)
        })
    }
}

/// `fmi3DeserializeFMUState`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi3DeserializeFMUState(
    instance: fmi3Instance,
    bytes: *const fmi3Byte,
    size: usize,
    state: *mut fmi3FMUState,
) -> fmi3Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(instance, |c| {
            state::deserialize(c, &calls::DESERIALIZE, bytes, size, state)
        })
    }
}
