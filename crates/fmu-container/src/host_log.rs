//! The log of an instance, which sends messages to the host.

use std::ffi::{CStr, CString, c_int};

use fmu_description::LogCategory;
use fmu_master::{Level, Message};

use crate::pointers::c_text;

/// Sends a message with a category and a status to the host.
pub(crate) type Sink = Box<dyn Fn(&CStr, c_int, &CStr)>;

/// The log of an instance.
pub(crate) struct HostLog {
    sink: Option<Sink>,
    on: Vec<LogCategory>,
}

const STATUSES: [LogCategory; 4] =
    [LogCategory::Error, LogCategory::Warning, LogCategory::Discard, LogCategory::Fatal];

fn all() -> Vec<LogCategory> {
    LogCategory::of_model(true).collect()
}

impl HostLog {
    /// A log of warnings and errors; with `debug`, of all messages.
    pub(crate) fn new(sink: Option<Sink>, debug: bool) -> Self {
        Self { sink, on: if debug { all() } else { STATUSES.to_vec() } }
    }

    /// Enables exactly the named categories, or disables them; without names, all.
    ///
    /// # Errors
    /// A category is unknown.
    pub(crate) fn switch(&mut self, on: bool, names: &[&CStr]) -> Result<(), String> {
        let mut named = Vec::new();
        for name in names {
            match all().into_iter().find(|category| category.name() == *name) {
                Some(LogCategory::All) => named = all(),
                Some(category) => named.push(category),
                None => {
                    let known = all().into_iter().map(|known| known.name().to_string_lossy());
                    let known = Vec::from_iter(known).join(", ");
                    return Err(format!(
                        "log category {name:?} is unknown; expected one of {known}"
                    ));
                }
            }
        }
        match (on, names.is_empty()) {
            (true, true) => self.on = all(),
            (true, false) => self.on = named,
            (false, true) => self.on.clear(),
            (false, false) => self.on.retain(|category| !named.contains(category)),
        }
        Ok(())
    }

    /// Sends a message.
    pub(crate) fn send(&self, category: LogCategory, text: &str) {
        let Some(sink) = self.sink.as_ref().filter(|_| self.on.contains(&category)) else { return };
        // `#` introduces a value reference (FMI 2.0.5, section 2.1.5; FMI 3.0.2, section 2.3.1).
        let text: CString = c_text(&text.replace('#', "##"));
        sink(category.name(), category.status(), &text);
    }

    /// Sends what an FMU has logged, with the name of its component.
    pub(crate) fn forward(&self, message: &Message) {
        let category = match message.level {
            Level::Info => LogCategory::Model,
            Level::Warning => LogCategory::Warning,
            Level::Error => LogCategory::Error,
            Level::Fatal => LogCategory::Fatal,
        };
        let times =
            if message.times > 1 { format!(" ({} times)", message.times) } else { String::new() };
        match &*message.instance {
            "" => self.send(category, &message.text),
            instance => self.send(category, &format!("{instance}: {}{times}", message.text)),
        }
    }
}
