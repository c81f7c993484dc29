//! Saving and restoring the state of an instance (FMI 2.0.5, section 2.1.8).

use super::{calls, fmi2Byte, fmi2Component, fmi2FMUstate, fmi2Status, with};
use crate::state;

/// `fmi2GetFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetFMUstate(c: fmi2Component, state: *mut fmi2FMUstate) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe { with(c, |c| state::get(c, &calls::GET_FMU_STATE, state)) }
}

/// `fmi2SetFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetFMUstate(c: fmi2Component, state: fmi2FMUstate) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe { with(c, |c| state::set(c, &calls::SET_FMU_STATE, state)) }
}

/// `fmi2FreeFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeFMUstate(
    c: fmi2Component,
    state: *mut fmi2FMUstate,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe { with(c, |c| state::free(c, &calls::FREE_FMU_STATE, state)) }
}

/// `fmi2SerializedFMUstateSize`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializedFMUstateSize(
    c: fmi2Component,
    state: fmi2FMUstate,
    size: *mut usize,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |c| {
            state::serialized_size(c, &calls::SERIALIZED_SIZE, state, size)
        })
    }
}

/// `fmi2SerializeFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SerializeFMUstate(
    c: fmi2Component,
    state: fmi2FMUstate,
    buffer: *mut fmi2Byte,
    size: usize,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |c| {
            state::serialize(c, &calls::SERIALIZE, state, buffer.cast(), size)
        })
    }
}

/// `fmi2DeSerializeFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2DeSerializeFMUstate(
    c: fmi2Component,
    bytes: *const fmi2Byte,
    size: usize,
    state: *mut fmi2FMUstate,
) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |c| {
            state::deserialize(c, &calls::DESERIALIZE, bytes.cast(), size, state)
        })
    }
}
