//! Arguments and results by the canonical ABI of the component model.

use std::ffi::CString;

use crate::pointers::{self, c_text};

/// The result of a function that returns more than a status.
#[repr(C, u8)]
pub enum Answer<T, E = u8> {
    Ok(T),
    Err(E),
}

/// A list of arguments or results, or a text.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct List<T> {
    pub(crate) first: *const T,
    pub(crate) length: usize,
}

pub(crate) type Text = List<u8>;
pub(crate) type Values<T> = *const Answer<List<T>>;

pub(crate) fn list<T>(values: &[T]) -> List<T> {
    List { first: values.as_ptr(), length: values.len() }
}

/// The elements of a list of the host.
///
/// # Safety
/// The host's promise: the list is valid during the call.
pub(crate) unsafe fn slice<'a, T>(first: *const T, length: usize) -> &'a [T] {
    // SAFETY: the caller's promise; a list without elements may have any pointer.
    unsafe { pointers::slice(first, length).unwrap_or_default() }
}

/// A text of the host, as it is passed to C.
///
/// # Safety
/// As [`slice`].
pub(crate) unsafe fn text(first: *const u8, length: usize) -> CString {
    // SAFETY: the caller's promise.
    c_text(&String::from_utf8_lossy(unsafe { slice(first, length) }))
}

/// The texts of a list of the host, as they are passed to C.
///
/// # Safety
/// As [`slice`].
pub(crate) unsafe fn texts(first: *const Text, n: usize) -> Vec<CString> {
    // SAFETY: the caller's promise.
    unsafe { slice(first, n).iter().map(|list| text(list.first, list.length)).collect() }
}
