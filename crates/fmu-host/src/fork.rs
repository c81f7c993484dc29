//! Tells a process from the processes that were forked from it.

#[cfg(target_os = "linux")]
use std::ffi::{c_int, c_void};
use std::io;
use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};

use memmap2::MmapMut;

/// Tells the process that made the guard from its forks, without a system call where memory can be zero in a forked
/// process.
#[derive(Debug)]
pub struct ForkGuard {
    page: Option<MmapMut>,
    process: u32,
}

impl ForkGuard {
    /// The guard of this process.
    ///
    /// # Errors
    /// There is no memory left.
    pub fn new() -> io::Result<Self> {
        let mut page = MmapMut::map_anon(1)?;
        page[0] = 1;
        Ok(Self { page: is_wiped_by_fork(&page).then_some(page), process: std::process::id() })
    }

    /// Whether this process has made the guard.
    #[inline]
    pub fn is_this_process(&self) -> bool {
        match &self.page {
            Some(page) => page[0] == 1,
            None => std::process::id() == self.process,
        }
    }
}

/// A value that exists once for the system, such as a temporary folder or a child process. Only the process that has
/// made the value drops it, not its forks.
#[derive(Debug)]
pub struct ProcessOwned<T> {
    value: ManuallyDrop<T>,
    process: u32,
}

impl<T> ProcessOwned<T> {
    /// A value of this process.
    pub fn new(value: T) -> Self {
        Self { value: ManuallyDrop::new(value), process: std::process::id() }
    }

    /// Whether this process has made the value.
    pub fn is_of_this_process(&self) -> bool {
        std::process::id() == self.process
    }
}

impl<T> Deref for ProcessOwned<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for ProcessOwned<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

impl<T> Drop for ProcessOwned<T> {
    fn drop(&mut self) {
        if self.is_of_this_process() {
            // SAFETY: the value is not used again.
            unsafe { ManuallyDrop::drop(&mut self.value) }
        }
    }
}

#[cfg(target_os = "linux")]
fn is_wiped_by_fork(page: &MmapMut) -> bool {
    const MADV_WIPEONFORK: c_int = 18;
    unsafe extern "C" {
        fn madvise(address: *mut c_void, length: usize, advice: c_int) -> c_int;
    }
    // SAFETY: the memory is a private anonymous map of its own, and stays as it is in this process.
    unsafe { madvise(page.as_ptr().cast_mut().cast(), page.len(), MADV_WIPEONFORK) == 0 }
}

#[cfg(not(target_os = "linux"))]
fn is_wiped_by_fork(_: &MmapMut) -> bool {
    false
}
