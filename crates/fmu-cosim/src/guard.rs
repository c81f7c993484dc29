//! Calls of FMUs that break the standard. The crate `fmi` panics on a status that FMI 2.0 does not have
//! and on a function that is missing; here that is a failure like others.

use std::any::Any;
use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe, PanicHookInfo};
use std::sync::Once;

thread_local! {
    /// Whether a function of an FMU is being called.
    static CALLING: Cell<bool> = const { Cell::new(false) };
}

/// Makes a call of an FMU; fails with what the function did that FMI 2.0 does not allow.
#[inline(always)]
pub(crate) fn guarded<T>(call: impl FnOnce() -> T) -> Result<T, String> {
    CALLING.set(true);
    let result = panic::catch_unwind(AssertUnwindSafe(call));
    CALLING.set(false);
    result.map_err(explain)
}

#[cold]
fn explain(panic: Box<dyn Any + Send>) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    match text.unwrap_or_default() {
        text if text.contains("Invalid status") => {
            "returned a status that FMI 2.0 does not have, or fmi2Pending, which is not waited for"
                .into()
        }
        text if text.contains("Expected function") => "is missing in the binary".into(),
        text => format!("panicked: {text}"),
    }
}

/// Keeps panics within calls of FMUs from being printed: they are told as failures.
pub(crate) fn silence() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let other = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            if !CALLING.get() {
                other(panic);
            } else if is_in_logger(panic) {
                // The FMU called it, and C cannot be unwound: the process would be aborted.
                eprintln!(
                    "error: an FMU logged a message with a status that FMI 2.0 does not have"
                );
                std::process::exit(1);
            }
        }));
    });
}

fn is_in_logger(panic: &PanicHookInfo<'_>) -> bool {
    panic
        .location()
        .is_some_and(|location| location.file().ends_with("logger.rs"))
}
