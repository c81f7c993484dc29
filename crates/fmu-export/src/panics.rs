//! Where the last panic of a thread happened, for the message to the host.

use std::cell::RefCell;
use std::panic::Location;

thread_local! {
    static LAST: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Remembers the place of a panic.
pub(crate) fn remember(place: Option<&Location<'_>>) {
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
