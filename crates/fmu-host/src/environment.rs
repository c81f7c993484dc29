//! The state of the process that an FMU may change behind the host's back.

use std::ffi::{CStr, c_char, c_int};
use std::ptr;

/// The locale of the C library by which numbers are formatted and parsed.
pub fn locale() -> Option<String> {
    const LC_NUMERIC: c_int = if cfg!(target_os = "linux") { 1 } else { 4 };
    unsafe extern "C" {
        fn setlocale(category: c_int, locale: *const c_char) -> *const c_char;
    }
    // SAFETY: with NULL, the function only returns the current locale, a string that is valid until
    // the next call.
    let name = unsafe { setlocale(LC_NUMERIC, ptr::null()) };
    if name.is_null() {
        return None;
    }
    // SAFETY: not NULL by the check.
    Some(unsafe { CStr::from_ptr(name) }.to_string_lossy().into_owned())
}

/// Bytes of memory that `malloc` has handed out and that were not freed; `None` where the C library
/// cannot tell.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn heap() -> Option<usize> {
    /// `struct mallinfo2` of glibc.
    #[repr(C)]
    struct Info {
        arena: usize,
        ordblks: usize,
        smblks: usize,
        hblks: usize,
        hblkhd: usize,
        usmblks: usize,
        fsmblks: usize,
        uordblks: usize,
        fordblks: usize,
        keepcost: usize,
    }
    let this = libloading::os::unix::Library::this();
    // SAFETY: the type is the one in glibc, which has the function since 2.33.
    let info = unsafe {
        let mallinfo2 = this.get::<unsafe extern "C" fn() -> Info>("mallinfo2").ok()?;
        mallinfo2()
    };
    Some(info.uordblks + info.hblkhd)
}

/// Bytes of memory that `malloc` has handed out and that were not freed; `None` where the C library
/// cannot tell.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn heap() -> Option<usize> {
    None
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_environment_is_read() {
        assert_eq!(super::locale().as_deref(), Some("C"));
        if let Some(before) = super::heap() {
            let memory = std::hint::black_box(vec![1_u8; 64 << 20]);
            assert!(super::heap().unwrap() >= before + memory.len());
        }
    }
}
