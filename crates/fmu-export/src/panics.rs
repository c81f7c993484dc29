//! Where the last panic of a thread happened, for the message to the host.

use std::cell::RefCell;
use std::panic::Location;
use std::sync::Once;

thread_local! {
    static LAST: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Keeps panic messages off stderr, as they go to the logger. The hook belongs to this library's own
/// copy of `std`, so the host's hook is unaffected.
pub(crate) fn silence() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| std::panic::set_hook(Box::new(|panic| remember(panic.location()))));
}

/// Remembers the place of a panic.
fn remember(place: Option<&Location<'_>>) {
    let place = place.map(ToString::to_string);
    // A panic during the exit of the thread has no place to be remembered.
    let _ = LAST.try_with(|last| {
        if let Ok(mut last) = last.try_borrow_mut() {
            *last = place;
        }
    });
}

/// The place of the last panic and a colon, as `src/lib.rs:12:5: `; empty if it is not known.
pub(crate) fn take_place() -> String {
    let place = LAST.try_with(|last| last.try_borrow_mut().ok()?.take());
    let place = place.ok().flatten();
    place.map_or_else(String::new, |place| format!("{place}: "))
}
