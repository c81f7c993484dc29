//! Tells a process from the processes that were forked from it.

#[cfg(target_os = "linux")]
use std::ffi::{c_int, c_void};
use std::mem::ManuallyDrop;
use std::ops::{Deref, DerefMut};
use std::process;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use memmap2::MmapMut;

/// The number of this process, without a system call where memory can be zero in a forked process.
#[inline]
pub fn this_process() -> u32 {
    /// A page with the number, which a fork finds zero; none where memory cannot be so.
    static PAGE: LazyLock<Option<MmapMut>> = LazyLock::new(|| {
        let page = MmapMut::map_anon(size_of::<AtomicU32>()).ok()?;
        is_wiped_by_fork(&page).then_some(page)
    });
    let Some(page) = &*PAGE else { return process::id() };
    // SAFETY: the page is aligned, large enough, never unmapped, and only accessed here, as an atomic number.
    let number = unsafe { &*page.as_ptr().cast::<AtomicU32>() };
    match number.load(Relaxed) {
        0 => {
            number.store(process::id(), Relaxed);
            process::id()
        }
        known => known,
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
        Self { value: ManuallyDrop::new(value), process: this_process() }
    }

    /// Whether this process has made the value.
    #[inline]
    pub fn is_of_this_process(&self) -> bool {
        this_process() == self.process
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
