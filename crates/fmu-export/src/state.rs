//! Saving and restoring the state of an instance through the pointers of a host (FMI 2.0.5, section
//! 2.1.8; FMI 3.0.2, section 2.2.10).

use std::ffi::c_void;

use crate::component::{Component, Failure, Outcome};
use crate::phase::Call;
use crate::pointers::{slice, slice_mut, variable};
use crate::reason::reason;
use crate::snapshot::{MAGIC, Snapshot};

/// The snapshot behind the host's pointer.
///
/// # Safety
/// `state` is NULL or points to readable memory; if it came from [`get`] or [`deserialize`], it is not
/// freed and not used concurrently.
unsafe fn snapshot<'a>(state: *mut c_void) -> Result<&'a mut Snapshot, Failure> {
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
unsafe fn required<'a, T>(pointer: *mut T) -> Result<&'a mut T, Failure> {
    // SAFETY: the caller's promise.
    unsafe { variable(pointer) }.ok_or_else(|| Failure::Refused("a pointer is NULL".into()))
}

/// Stores a snapshot in the host's variable, which is NULL or has one already.
///
/// # Safety
/// As [`snapshot`].
unsafe fn store(taken: Snapshot, state: &mut *mut c_void) -> Result<(), Failure> {
    match state.is_null() {
        true => *state = Box::into_raw(Box::new(taken)).cast(),
        // SAFETY: the caller's promise.
        false => unsafe { *snapshot(*state)? = taken },
    }
    Ok(())
}

/// # Safety
/// The host's promises: `state` is NULL, or points to NULL or to a state.
pub(crate) unsafe fn get(c: &mut Component, call: &Call, state: *mut *mut c_void) -> Outcome {
    // SAFETY: the caller's promise.
    c.call(call, |c| unsafe { store(c.snapshot(), required(state)?) })
}

/// # Safety
/// As [`snapshot`].
pub(crate) unsafe fn set(c: &mut Component, call: &Call, state: *mut c_void) -> Outcome {
    // SAFETY: the caller's promise.
    c.call(call, |c| Ok(c.restore(unsafe { snapshot(state)? })?))
}

/// # Safety
/// As [`get`]. The state is not used again.
pub(crate) unsafe fn free(c: &mut Component, call: &Call, state: *mut *mut c_void) -> Outcome {
    c.call(call, |_| {
        // SAFETY: the caller's promise. A valid snapshot came from a box.
        unsafe {
            if let Some(state) = variable(state).filter(|state| !state.is_null()) {
                drop(Box::from_raw(snapshot(*state)?));
                *state = std::ptr::null_mut();
            }
        }
        Ok(())
    })
}

/// # Safety
/// As [`snapshot`]; `size` is NULL or writable.
pub(crate) unsafe fn serialized_size(
    c: &mut Component,
    call: &Call,
    state: *mut c_void,
    size: *mut usize,
) -> Outcome {
    // SAFETY: the caller's promise.
    c.call(call, |c| unsafe {
        *required(size)? = snapshot(state)?.to_bytes(c.slave())?.len();
        Ok(())
    })
}

/// # Safety
/// As [`snapshot`]; `buffer` is NULL or has `size` bytes.
pub(crate) unsafe fn serialize(
    c: &mut Component,
    call: &Call,
    state: *mut c_void,
    buffer: *mut u8,
    size: usize,
) -> Outcome {
    c.call(call, |c| {
        // SAFETY: the caller's promise.
        let (state, buffer) = unsafe { (snapshot(state)?, slice_mut(buffer, size)) };
        let bytes = state.to_bytes(c.slave())?;
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
}

/// # Safety
/// As [`get`]; `bytes` is NULL or has `size` bytes.
pub(crate) unsafe fn deserialize(
    c: &mut Component,
    call: &Call,
    bytes: *const u8,
    size: usize,
    state: *mut *mut c_void,
) -> Outcome {
    c.call(call, |c| {
        // SAFETY: the caller's promise.
        let (bytes, state) = unsafe { (slice(bytes, size), required(state)?) };
        let bytes = bytes.ok_or_else(|| Failure::Refused("the bytes are NULL".into()))?;
        let restored = Snapshot::from_bytes(bytes, c.slave())?;
        if !restored.can_be_saved(call) {
            return Err(Failure::Refused("the bytes are damaged".into()));
        }
        // SAFETY: the caller's promise.
        unsafe { store(restored, state) }
    })
}
