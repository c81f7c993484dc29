//! SavedState states behind pointers of a host (FMI 2.0.5, section 2.1.8; FMI 3.0.2, section 2.2.7.4).

use std::ffi::c_void;

use crate::error::ModelError;
use crate::instance::Instance;
use crate::snapshot::{MAGIC, Snapshot};

/// A saved state in memory.
#[repr(C)]
struct SavedState {
    /// Distinguishes our states from other memory.
    magic: [u8; 8],
    snapshot: Snapshot,
}

impl Drop for SavedState {
    fn drop(&mut self) {
        // Helps to detect a pointer that the host uses after freeing it.
        self.magic = [0; 8];
        std::hint::black_box(&self.magic); // keeps the compiler from removing the write
    }
}

/// The state behind the host's pointer.
///
/// # Safety
/// `state` is NULL or points to readable memory; if it came from [`store`], it is not freed and not used
/// concurrently.
unsafe fn saved<'a>(state: *mut c_void) -> Result<&'a mut SavedState, ModelError> {
    let state = state.cast::<SavedState>();
    if state.is_null() {
        return Err(ModelError::refuse("the FMU state is NULL"));
    }
    // SAFETY: the caller's promise. Our states are aligned and start with a magic number, which is
    // checked before the memory is used as a state.
    unsafe {
        if state.is_aligned() && state.cast::<[u8; 8]>().read() == MAGIC {
            return Ok(&mut *state);
        }
    }
    Err(ModelError::refuse("the pointer does not point to an FMU state"))
}

/// The host's variable.
fn required<T>(variable: Option<&mut T>) -> Result<&mut T, ModelError> {
    variable.ok_or_else(|| ModelError::refuse("a pointer is NULL"))
}

/// Stores a state in the host's variable, which is NULL or has one already.
///
/// # Safety
/// As [`saved`].
unsafe fn store(snapshot: Snapshot, state: &mut *mut c_void) -> Result<(), ModelError> {
    let new = SavedState { magic: MAGIC, snapshot };
    match state.is_null() {
        true => *state = Box::into_raw(Box::new(new)).cast(),
        // SAFETY: the caller's promise.
        false => unsafe { *saved(*state)? = new },
    }
    Ok(())
}

impl Instance {
    /// Checks that there is memory for a state, and for the next message.
    #[cfg(all(target_arch = "wasm32", feature = "sources"))]
    fn check_memory(&self) -> Result<(), ModelError> {
        const MESSAGE: usize = 2 << 10;
        let found = Vec::<u8>::new().try_reserve_exact(2 * size_of_val(&self.model) + MESSAGE);
        found.map_err(|_| ModelError::refuse("there is no memory for another state"))
    }

    /// Elsewhere, memory is not short.
    #[cfg(not(all(target_arch = "wasm32", feature = "sources")))]
    fn check_memory(&self) -> Result<(), ModelError> {
        Ok(())
    }
}

/// Each is safe if the host has made the promises of [`saved`] for the pointer to a state.
impl Instance {
    pub(super) unsafe fn get_fmu_state(
        &mut self,
        state: Option<&mut *mut c_void>,
    ) -> Result<(), ModelError> {
        let state = required(state)?;
        self.check_memory()?;
        // SAFETY: the caller's promise.
        unsafe { store(self.snapshot()?, state) }
    }

    pub(super) unsafe fn set_fmu_state(&mut self, state: *mut c_void) -> Result<(), ModelError> {
        // SAFETY: the caller's promise.
        self.restore(&unsafe { saved(state) }?.snapshot)
    }

    pub(super) unsafe fn free_fmu_state(
        &mut self,
        state: Option<&mut *mut c_void>,
    ) -> Result<(), ModelError> {
        if let Some(state) = state.filter(|state| !state.is_null()) {
            // SAFETY: the caller's promise. A valid state came from a box.
            drop(unsafe { Box::from_raw(saved(*state)?) });
            *state = std::ptr::null_mut();
        }
        Ok(())
    }

    pub(super) unsafe fn serialized_fmu_state_size(
        &mut self,
        state: *mut c_void,
        size: Option<&mut usize>,
    ) -> Result<(), ModelError> {
        let size = required(size)?;
        // SAFETY: the caller's promise.
        *size = self.serialize(&unsafe { saved(state) }?.snapshot)?.len();
        Ok(())
    }

    pub(super) unsafe fn serialize_fmu_state(
        &mut self,
        state: *mut c_void,
        buffer: Option<&mut [u8]>,
    ) -> Result<(), ModelError> {
        // SAFETY: the caller's promise.
        let bytes = self.serialize(&unsafe { saved(state) }?.snapshot)?;
        let (size, expected) = (buffer.as_ref().map_or(0, |b| b.len()), bytes.len());
        match buffer.and_then(|buffer| buffer.get_mut(..expected)) {
            Some(room) => room.copy_from_slice(&bytes),
            None => {
                return Err(ModelError::refuse(format_args!(
                    "the buffer is NULL or its size {size} is too small; expected {expected} bytes"
                )));
            }
        }
        Ok(())
    }

    pub(super) unsafe fn deserialize_fmu_state(
        &mut self,
        bytes: Option<&[u8]>,
        state: Option<&mut *mut c_void>,
    ) -> Result<(), ModelError> {
        let state = required(state)?;
        let bytes = bytes.ok_or_else(|| ModelError::refuse("the bytes are NULL"))?;
        self.check_memory()?;
        let restored = self.deserialize(bytes)?;
        // SAFETY: the caller's promise.
        unsafe { store(restored, state) }
    }
}
