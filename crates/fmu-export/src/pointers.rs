//! Pointers of a host, and the arrays and texts behind them.

use std::borrow::Cow;
use std::ffi::{CStr, CString, c_char, c_void};

/// A pointer to an instance.
pub(crate) type Pointer = *mut c_void;

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

/// The strings behind pointers.
///
/// # Safety
/// As [`text`].
pub(crate) unsafe fn texts<'a>(pointers: &[*const c_char]) -> Vec<Option<&'a CStr>> {
    // SAFETY: the caller's promise.
    pointers.iter().map(|&pointer| unsafe { text(pointer) }).collect()
}

/// A text of the host for a message, with escapes if it is not UTF-8.
pub(crate) fn readable(text: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(text) {
        Ok(text) => text.into(),
        Err(_) => text.escape_ascii().to_string().into(),
    }
}

/// A text for C, where strings end at a zero byte. Our messages have none, but they may quote the host.
pub(crate) fn c_text(text: &str) -> CString {
    CString::new(text.replace('\0', " ")).unwrap_or_default()
}

/// A message for C, where `#` introduces a value reference (FMI 2.0.5, section 2.1.5; FMI 3.0.2, section 2.3.1).
pub(crate) fn c_message(text: &str) -> CString {
    let mut bytes = Vec::with_capacity(text.len() + 1);
    // Less code than `replace`.
    for byte in text.bytes() {
        bytes.push(if byte == 0 { b' ' } else { byte });
        if byte == b'#' {
            bytes.push(byte);
        }
    }
    CString::new(bytes).unwrap_or_default()
}
