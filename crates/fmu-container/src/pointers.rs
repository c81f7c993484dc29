//! Pointers of a host, and the arrays and texts behind them.

use std::ffi::{CStr, CString, c_char};

pub(crate) const NULL_ARRAY: &str = "an array is NULL though its length is not 0";

/// `n` elements behind a pointer; `None` if it is NULL although `n` is not 0.
///
/// # Safety
/// `pointer` is NULL or points to `n` elements that do not change during the slice's lifetime.
pub(crate) unsafe fn slice<'a, T>(pointer: *const T, n: usize) -> Option<&'a [T]> {
    match (pointer.is_null(), n) {
        (_, 0) => Some(&[]),
        (true, _) => None,
        // SAFETY: not NULL by the check, and valid for `n` elements by the caller's promise.
        (false, _) => Some(unsafe { std::slice::from_raw_parts(pointer, n) }),
    }
}

/// Like [`slice()`], but mutable.
///
/// # Safety
/// As [`slice()`], and the elements are not used otherwise during the slice's lifetime.
pub(crate) unsafe fn slice_mut<'a, T>(pointer: *mut T, n: usize) -> Option<&'a mut [T]> {
    match (pointer.is_null(), n) {
        (_, 0) => Some(&mut []),
        (true, _) => None,
        // SAFETY: not NULL by the check, and valid for `n` elements by the caller's promise.
        (false, _) => Some(unsafe { std::slice::from_raw_parts_mut(pointer, n) }),
    }
}

/// The string behind a pointer; `None` for NULL.
///
/// # Safety
/// `text` is NULL or points to a zero-terminated string that lives long enough.
pub(crate) unsafe fn text<'a>(text: *const c_char) -> Option<&'a CStr> {
    // SAFETY: not NULL by the check, and a C string by the caller's promise.
    (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) })
}

/// A text for C, where strings end at a zero byte.
pub(crate) fn c_text(text: &str) -> CString {
    CString::new(text.replace('\0', " ")).unwrap_or_default()
}
