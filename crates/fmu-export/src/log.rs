//! The log categories of FMI 2.0.5 (section 2.2.4), and which of them are enabled.

use std::ffi::{CStr, CString};

use fmu_description::LOG_CATEGORIES;

use crate::reason::Reason;

/// A log category.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Category {
    Error = 1 << 0,
    Warning = 1 << 1,
    Discard = 1 << 2,
    Fatal = 1 << 3,
    Events = 1 << 4,
}

/// All categories that the slave logs to, in the order of [`LOG_CATEGORIES`], whose last category
/// includes all others.
const CATEGORIES: [Category; 5] = [
    Category::Error,
    Category::Warning,
    Category::Discard,
    Category::Fatal,
    Category::Events,
];

const EVERY: u8 = STATUSES | Category::Events as u8;
const STATUSES: u8 = Category::Error as u8
    | Category::Warning as u8
    | Category::Discard as u8
    | Category::Fatal as u8;

impl Category {
    /// The name of the category in FMI.
    pub(crate) fn name(self) -> &'static CStr {
        CATEGORIES
            .iter()
            .zip(&LOG_CATEGORIES)
            .find(|(known, _)| **known == self)
            .map_or(c"logAll", |(_, (name, _))| *name)
    }
}

/// Sends a message to the host.
pub(crate) type Sink = Box<dyn Fn(Category, &str)>;

/// The log of an instance.
pub(crate) struct Log {
    sink: Option<Sink>,
    /// Enabled categories, as a set of [`Category`] bits.
    on: u8,
}

impl Log {
    /// Creates a log with the status categories enabled until the host disables them with
    /// `fmi2SetDebugLogging`; events are enabled if `debug` is true.
    pub(crate) fn new(sink: Option<Sink>, debug: bool) -> Self {
        let on = if debug { EVERY } else { STATUSES };
        Self { sink, on }
    }

    /// Enables exactly the named categories, or disables them; without names, all categories.
    pub(crate) fn switch(&mut self, on: bool, categories: &[&CStr]) -> Result<(), Reason> {
        let mut set = 0;
        for name in categories {
            set |= Self::bits(name)?;
        }
        self.on = match (on, categories.is_empty()) {
            (true, true) => EVERY,
            (true, false) => set,
            (false, true) => 0,
            (false, false) => self.on & !set,
        };
        Ok(())
    }

    fn bits(name: &CStr) -> Result<u8, Reason> {
        match LOG_CATEGORIES.iter().position(|(known, _)| *known == name) {
            Some(index) => Ok(CATEGORIES.get(index).map_or(EVERY, |c| *c as u8)),
            None => Err(unknown(name.to_owned())),
        }
    }

    /// Sends a message. It is formatted only if its category is enabled.
    pub(crate) fn send(&self, category: Category, message: impl FnOnce() -> String) {
        if let Some(sink) = &self.sink
            && self.on & category as u8 != 0
        {
            sink(category, &message());
        }
    }
}

fn unknown(category: CString) -> Reason {
    Reason::new(move || {
        let known = LOG_CATEGORIES.map(|(name, _)| name.to_string_lossy());
        let known = known.join(", ");
        format!("log category {category:?} is unknown; expected one of {known}")
    })
}
