//! The log of an instance: categories (FMI 2.0.5, section 2.2.4), which of them are enabled, and where the
//! last panic happened.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::ffi::{CStr, c_int};
use std::fmt::{Arguments, Debug, Display, Formatter};
use std::mem;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::rc::Rc;
use std::sync::Once;

use fmu_description::{LogCategory, OwnCategory};

use crate::error::ModelError;
use crate::pointers::readable;

/// Sets of categories, as bits.
type Categories = u32;

const EVERY: Categories = Categories::MAX;
const STATUSES: Categories = bit(LogCategory::Events) - 1;

const fn bit(category: LogCategory) -> Categories {
    1 << category as u32
}

/// The bit of a category that a model declares.
const fn bit_of_own(index: usize) -> Categories {
    const FIRST: Categories = bit(LogCategory::All) << 1;
    const { assert!(FIRST.leading_zeros() as usize + 1 >= OwnCategory::MAX) };
    FIRST << index
}

/// What a host learns of a message besides its text.
#[derive(Clone, Copy)]
pub(crate) struct Heading {
    pub(crate) category: &'static CStr,
    /// The status, with the number that it has in both versions of FMI.
    pub(crate) status: c_int,
}

/// Sends a message to the host.
pub(crate) type Sink = Box<dyn Fn(Heading, &str)>;

/// The log of an instance: a model writes to it by a field with the attribute `log`, which the instance connects.
/// The log of a struct without an instance is silent.
///
/// A model may have more logs, each with a category of its own that a host can switch:
/// `#[log(category = "limits")] limits: Log`, with a doc comment as the description. All its messages have this
/// category. The host gets information if it enables this category or debug logging, and warnings and errors also if it
/// wants these of the whole model, as by default.
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
pub struct Log {
    open: Option<Rc<Open>>,
    own: Option<Own>,
}

/// The category of a log, if the model declares one for it.
#[derive(Clone, Copy)]
struct Own {
    name: &'static CStr,
    bit: Categories,
}

/// A log that somebody reads.
struct Open {
    sink: Sink,
    /// Enabled categories.
    on: Cell<Categories>,
}

impl Debug for Log {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.open.is_some() { "Log" } else { "Log (silent)" })
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
        Self { open: sink.map(|sink| Rc::new(Open { sink, on })), own: None }
    }

    /// The same log for the messages of a category, by its index in those that the model declares.
    pub(crate) fn in_category(&self, all: &[OwnCategory], index: Option<usize>) -> Self {
        let own = index
            .and_then(|index| Some(Own { name: all.get(index)?.name, bit: bit_of_own(index) }));
        Self { open: self.open.clone(), own }
    }

    /// Enables exactly the named categories, or disables them; without names, all categories. The model declares the
    /// categories `own`, and messages without one of these if `has_log`.
    pub(crate) fn switch(
        &self,
        on: bool,
        categories: &[&CStr],
        has_log: bool,
        own: &[OwnCategory],
    ) -> Result<(), ModelError> {
        let mut set = 0;
        for &name in categories {
            set |=
                categories_named(name, has_log, own).ok_or_else(|| unknown(name, has_log, own))?;
        }
        if let Some(open) = &self.open {
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
        let Some(open) = &self.open else { return };
        let (name, wanted_by) = match (self.own, category) {
            (None, _) => (category.name(), bit(category)),
            (Some(own), LogCategory::Model) => (own.name, own.bit),
            (Some(own), _) => (own.name, own.bit | bit(category)),
        };
        if open.on.get() & wanted_by != 0 {
            let heading = Heading { category: name, status: category.status() };
            (open.sink)(heading, &message.to_string());
        }
    }
}

/// Drops what a panic carries. Its destructor is the model's, and might panic as well.
pub(crate) fn discard(panic: Box<dyn Any + Send>) {
    let dropped = catch_unwind(AssertUnwindSafe(|| drop(panic)));
    let _ = dropped.map_err(mem::forget);
}

/// The categories that a name stands for; `None` if the model has no such category.
fn categories_named(name: &CStr, has_log: bool, own: &[OwnCategory]) -> Option<Categories> {
    match LogCategory::of_model(has_log).find(|category| category.name() == name) {
        Some(LogCategory::All) => Some(EVERY),
        Some(category) => Some(bit(category)),
        None => own.iter().position(|own| own.name == name).map(bit_of_own),
    }
}

fn unknown(category: &CStr, has_log: bool, own: &[OwnCategory]) -> ModelError {
    let known = LogCategory::of_model(has_log).map(LogCategory::name);
    let known = known.chain(own.iter().map(|own| own.name));
    let known: Vec<_> = known.map(|name| readable(name.to_bytes()).into_owned()).collect();
    let known = known.join(", ");
    let category = readable(category.to_bytes());
    ModelError::refuse(format_args!(
        "log category \"{category}\" is unknown; expected one of {known}"
    ))
}

thread_local! {
    /// Where the last panic of the thread happened.
    static LAST: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Keeps panic messages off stderr, as they go to the logger. The hook belongs to this library's own copy of `std`, so the
/// host's hook is unaffected.
pub(crate) fn silence_panics<F: Fn(&PanicHookInfo<'_>) + Send + Sync + 'static>(report: F) {
    const { assert!(size_of::<F>() == 0, "a hook is never freed, so it must not allocate") };
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        std::panic::set_hook(Box::new(report));
    });
}

/// Remembers where a panic happened, for the function that catches it.
#[cfg(not(target_arch = "wasm32"))]
pub(crate) fn remember_place(panic: &PanicHookInfo<'_>) {
    let place = panic.location().map(ToString::to_string);
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
