//! Slices and strings from the pointers of a host.

use std::ffi::{CStr, c_char};

/// The reason why a pointer to a single result is refused.
pub(crate) const NULL_RESULT: &str = "a pointer to a result is NULL";

/// The reason why [`slice`] or [`slice_mut`] returned `None`.
pub(crate) const NULL_ARRAY: &str = "an array is NULL though its length is not 0";

/// `n` elements behind a pointer; `None` if it is NULL although `n` is not 0.
///
/// # Safety
/// `pointer` is NULL or points to `n` elements that do not change during the slice's lifetime.
pub(crate) unsafe fn slice<'a, T>(pointer: *const T, n: usize) -> Option<&'a [T]> {
    if n == 0 {
        return Some(&[]);
    }
    // SAFETY: not NULL by the check, and valid for `n` elements by the caller's promise.
    (!pointer.is_null()).then(|| unsafe { std::slice::from_raw_parts(pointer, n) })
}

/// Like [`slice`], but mutable.
///
/// # Safety
/// As [`slice`], and the elements are not used otherwise during the slice's lifetime.
pub(crate) unsafe fn slice_mut<'a, T>(pointer: *mut T, n: usize) -> Option<&'a mut [T]> {
    if n == 0 {
        return Some(&mut []);
    }
    // SAFETY: not NULL by the check, and valid for `n` elements by the caller's promise.
    (!pointer.is_null()).then(|| unsafe { std::slice::from_raw_parts_mut(pointer, n) })
}

/// The string behind a pointer; `None` for NULL.
///
/// # Safety
/// `text` is NULL or points to a zero-terminated string that lives long enough.
pub(crate) unsafe fn text<'a>(text: *const c_char) -> Option<&'a CStr> {
    // SAFETY: not NULL by the check, and a C string by the caller's promise.
    (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) })
}

/// The host's variable behind a pointer; `None` for NULL.
///
/// # Safety
/// `pointer` is NULL, or readable and writable, and not used otherwise during the lifetime.
pub(crate) unsafe fn variable<'a, T>(pointer: *mut T) -> Option<&'a mut T> {
    // SAFETY: the caller's promise.
    unsafe { pointer.as_mut() }
}
