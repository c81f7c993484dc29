//! Saving and restoring the state of an instance (FMI 2.0.5, section 2.1.8).

use super::{fmi2Byte, fmi2Component, fmi2FMUstate, fmi2Status, slice, slice_mut, with};
use crate::component::Failure;
use crate::phase;
use crate::reason::reason;
use crate::snapshot::{MAGIC, Snapshot};

/// The snapshot behind the host's pointer.
///
/// # Safety
/// `state` is NULL or points to readable memory; if it came from [`fmi2GetFMUstate`] or
/// [`fmi2DeSerializeFMUstate`], it is not freed and not used concurrently.
unsafe fn snapshot<'a>(state: fmi2FMUstate) -> Result<&'a mut Snapshot, Failure> {
    let state = state.cast::<Snapshot>();
    if state.is_null() {
        return Err(Failure::Refused("the FMU state is NULL".into()));
    }
    // SAFETY: the caller's promise. Our states are aligned and start with a magic number, which is
    // checked before the memory is used as a state.
    unsafe {
        if state.is_aligned() && state.cast::<[u8; 8]>().read() == MAGIC {
            return Ok(&mut *state);
        }
    }
    Err(Failure::Refused(
        "the pointer does not point to an FMU state".into(),
    ))
}

/// The host's variable behind a pointer.
///
/// # Safety
/// `pointer` is NULL, or readable and writable.
unsafe fn variable<'a, T>(pointer: *mut T) -> Result<&'a mut T, Failure> {
    // SAFETY: the caller's promise.
    unsafe { pointer.as_mut() }.ok_or_else(|| Failure::Refused("a pointer is NULL".into()))
}

/// `fmi2GetFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2GetFMUstate(c: fmi2Component, state: *mut fmi2FMUstate) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.call(&phase::GET_FMU_STATE, |component| {
                let state = variable(state)?;
                if state.is_null() {
                    *state = Box::into_raw(Box::new(component.snapshot())).cast();
                } else {
                    *snapshot(*state)? = component.snapshot();
                }
                Ok(())
            })
        })
    }
}

/// `fmi2SetFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2SetFMUstate(c: fmi2Component, state: fmi2FMUstate) -> fmi2Status {
    // SAFETY: the caller's promise.
    unsafe {
        with(c, |component| {
            component.call(&phase::SET_FMU_STATE, |component| {
                Ok(component.restore(snapshot(state)?)?)
            })
        })
    }
}

/// `fmi2FreeFMUstate`
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fmi2FreeFMUstate(
    c: fmi2Component,
    state: *mut fmi2FMUstate,
) -> fmi2Status {
    // SAFETY: the caller's promise. A valid snapshot came from a box.
    unsafe {
        with(c, |component| {
            component.call(&phase::FREE_FMU_STATE, |_| {
                if let Some(state) = state.as_mut().filter(|state| !state.is_null()) {
                    drop(Box::from_raw(snapshot(*state)?));
                    *state = std::ptr::null_mut();
                }
                Ok(())
            })
        })
    }
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
        with(c, |component| {
            component.call(&phase::SERIALIZED_SIZE, |component| {
                *variable(size)? = snapshot(state)?.to_bytes(component.slave())?.len();
                Ok(())
            })
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
    // SAFETY: the caller's promise: `size` bytes, or NULL.
    unsafe {
        let buffer = slice_mut(buffer.cast::<u8>(), size);
        with(c, |component| {
            component.call(&phase::SERIALIZE, |component| {
                let bytes = snapshot(state)?.to_bytes(component.slave())?;
                let room = buffer.and_then(|buffer| buffer.get_mut(..bytes.len()));
                let Some(room) = room else {
                    let expected = bytes.len();
                    return Err(Failure::Refused(reason!(
                        "the buffer is NULL or its size {size} is too small; expected {expected} bytes"
                    )));
                };
                room.copy_from_slice(&bytes);
                Ok(())
            })
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
    // SAFETY: the caller's promise: `size` bytes, or NULL.
    unsafe {
        let bytes = slice(bytes.cast::<u8>(), size);
        with(c, |component| {
            component.call(&phase::DESERIALIZE, |component| {
                let state = variable(state)?;
                let bytes = bytes.ok_or_else(|| Failure::Refused("the bytes are NULL".into()))?;
                let restored = Snapshot::from_bytes(bytes, component.slave())?;
                if state.is_null() {
                    *state = Box::into_raw(Box::new(restored)).cast();
                } else {
                    *snapshot(*state)? = restored;
                }
                Ok(())
            })
        })
    }
}
