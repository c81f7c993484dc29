//! The call that a host makes, and its end by a panic.

use fmu_description::LogCategory;
use std::cell::Cell;
use std::panic::PanicHookInfo;
use std::ptr::null_mut;

use super::scratch::{self, put};
use crate::canonical::Answer;
use crate::edge::fmi3::{fmi3OK, fmi3Status};
use crate::fast::instance_at;
use crate::log::text_of_panic;
use crate::pointers::Pointer;

thread_local! {
    /// The instance of the current call, whose log has the message of a panic.
    pub(super) static CURRENT: Cell<Pointer> = const { Cell::new(null_mut()) };
}

/// Does the operation of a call, which uses an instance, unless the pointer is NULL.
pub(super) fn call<T>(instance: Pointer, operation: impl FnOnce() -> T) -> T {
    CURRENT.set(instance);
    let result = operation();
    scratch::end();
    result
}

/// The answer of a function of C, which has a result if its status is good.
pub(super) fn answer<T>(status: fmi3Status, result: T) -> *const Answer<T> {
    put(match status {
        fmi3OK => Answer::Ok(result),
        status => Answer::Err(status.0 as u8),
    })
}

/// Tells the host of a panic, after which the component ends.
pub(super) fn report_panic(panic: &PanicHookInfo<'_>) {
    // SAFETY: the call that panicked does not continue, so the instance is not used otherwise.
    if let Some(instance) = unsafe { instance_at(CURRENT.get()) } {
        let place = panic.location().map_or_else(String::new, |place| format!("{place}: "));
        let text = text_of_panic(panic.payload());
        let message = format_args!("{place}the model panicked, and the component ends: {text}");
        instance.shared.settings.log.send(LogCategory::Fatal, message);
    }
}
