//! The log of an instance: categories (FMI 2.0.5, section 2.2.4), which of them are enabled, and where the
//! last panic happened.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::ffi::CStr;
use std::fmt::{Arguments, Debug, Display, Formatter};
use std::mem;
use std::panic::{AssertUnwindSafe, Location, PanicHookInfo, catch_unwind};
use std::rc::Rc;
use std::sync::Once;

use fmu_description::LogCategory;

use crate::error::ModelError;

const EVERY: u8 = STATUSES | bit(LogCategory::Events) | bit(LogCategory::Model);
const STATUSES: u8 = bit(LogCategory::Events) - 1;

const fn bit(category: LogCategory) -> u8 {
    1 << category as u8
}

/// Sends a message to the host.
pub(crate) type Sink = Box<dyn Fn(LogCategory, &str)>;

/// The log of an instance: a model writes to it by a field with the attribute `log`, which the instance connects.
/// The log of a struct without an instance is silent.
///
/// A message that nobody wants is not formatted. In [`Continuous::evaluate`](crate::Continuous::evaluate), a model
/// may write messages for states that the solver only tries.
///
/// ```
/// use fmu_export::prelude::*;
///
/// /// Valve that may be stuck
/// #[derive(Model)]
/// #[model(sample_time = 0.1)]
/// pub struct Valve {
///     /// opening
///     #[input(unit = "%")]
///     opening: f64,
///     /// flow
///     #[output(unit = "l/min")]
///     flow: f64,
///     #[log]
///     log: Log,
/// }
///
/// impl Simulate for Valve {
///     fn step(&mut self, time: f64, _step: f64) -> Result<(), ModelError> {
///         if self.opening < 1.0 {
///             self.log.warning(format_args!("at t = {time} s: the valve is stuck"));
///         }
///         self.flow = 0.5 * self.opening;
///         Ok(())
///     }
/// }
/// ```
#[derive(Clone, Default)]
pub struct Log(Option<Rc<Open>>);

/// A log that somebody reads.
struct Open {
    sink: Sink,
    /// Enabled categories, as a set of bits.
    on: Cell<u8>,
}

impl Debug for Log {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.0.is_some() { "Log" } else { "Log (silent)" })
    }
}

impl Log {
    /// Says what happens: status OK, category `logModel`, which is enabled with debug logging only.
    pub fn info(&self, message: impl Display) {
        self.send(LogCategory::Model, format_args!("{message}"));
    }

    /// Says what is unusual: status warning, category `logStatusWarning`.
    pub fn warning(&self, message: impl Display) {
        self.send(LogCategory::Warning, format_args!("{message}"));
    }

    /// Says what is wrong though the simulation goes on: status error, category `logStatusError`. A step that fails
    /// returns a [`ModelError`] instead.
    pub fn error(&self, message: impl Display) {
        self.send(LogCategory::Error, format_args!("{message}"));
    }

    /// Creates a log with the status categories enabled until the host disables them; the others are enabled if
    /// `debug` is true.
    pub(crate) fn new(sink: Option<Sink>, debug: bool) -> Self {
        let on = Cell::new(if debug { EVERY } else { STATUSES });
        Self(sink.map(|sink| Rc::new(Open { sink, on })))
    }

    /// Enables exactly the named categories, or disables them; without names, all categories. Only some models have
    /// the category for their own messages.
    pub(crate) fn switch(
        &self,
        on: bool,
        categories: &[&CStr],
        has_own: bool,
    ) -> Result<(), ModelError> {
        let mut set = 0;
        for &name in categories {
            let mut known = LogCategory::of_model(has_own);
            let category = known.find(|category| category.name() == name);
            set |= match category.ok_or_else(|| unknown(name, has_own))? {
                LogCategory::All => EVERY,
                category => bit(category),
            };
        }
        if let Some(open) = &self.0 {
            open.on.set(match (on, categories.is_empty()) {
                (true, true) => EVERY,
                (true, false) => set,
                (false, true) => 0,
                (false, false) => open.on.get() & !set,
            });
        }
        Ok(())
    }

    /// Sends what a panic in a function of C means, where it happened, and its message.
    #[cold]
    #[inline(never)]
    pub(crate) fn send_panic(&self, function: &str, what: &str, panic: Box<dyn Any + Send>) {
        let (place, text) = (take_place_of_panic(), text_of_panic(&*panic));
        self.send(LogCategory::Fatal, format_args!("{function}: {place}{what}: {text}"));
        discard(panic);
    }

    /// Sends a message. It is formatted only if its category is enabled.
    pub(crate) fn send(&self, category: LogCategory, message: Arguments<'_>) {
        if let Some(open) = &self.0
            && open.on.get() & bit(category) != 0
        {
            (open.sink)(category, &message.to_string());
        }
    }
}

/// Drops what a panic carries. Its destructor is the model's, and might panic as well.
pub(crate) fn discard(panic: Box<dyn Any + Send>) {
    let dropped = catch_unwind(AssertUnwindSafe(|| drop(panic)));
    let _ = dropped.map_err(mem::forget);
}

fn unknown(category: &CStr, has_own: bool) -> ModelError {
    let known = LogCategory::of_model(has_own).map(LogCategory::name);
    let known: Vec<_> = known.map(|name| name.to_string_lossy().into_owned()).collect();
    let known = known.join(", ");
    let category = category.to_string_lossy();
    ModelError::refuse(format_args!(
        "log category \"{category}\" is unknown; expected one of {known}"
    ))
}

thread_local! {
    /// Where the last panic of the thread happened.
    static LAST: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Keeps panic messages off stderr, as they go to the logger. The hook belongs to this library's own copy of `std`, so the
/// host's hook is unaffected. `report` is for panics that cannot be caught.
pub(crate) fn silence_panics<F: Fn(&PanicHookInfo<'_>) + Send + Sync + 'static>(report: F) {
    const { assert!(size_of::<F>() == 0, "a hook is never freed, so it must not allocate") };
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        std::panic::set_hook(Box::new(move |panic| {
            remember(panic.location());
            report(panic);
        }));
    });
}

fn remember(place: Option<&Location<'_>>) {
    let place = place.map(ToString::to_string);
    // A panic during the exit of the thread has no place to be remembered.
    let _ = LAST.try_with(|last| {
        if let Ok(mut last) = last.try_borrow_mut() {
            *last = place;
        }
    });
}

/// The message of a panic.
pub(crate) fn text_of_panic(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message")
}

/// The place of the last panic and a colon, as `src/lib.rs:12:5: `; empty if it is not known.
fn take_place_of_panic() -> String {
    let place = LAST.try_with(|last| last.try_borrow_mut().ok()?.take());
    let place = place.ok().flatten();
    place.map_or_else(String::new, |place| format!("{place}: "))
}
