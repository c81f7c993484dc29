//! What FMUs say through their logger, which the crate `fmi` hands to the crate `log`.

use std::cell::RefCell;
use std::sync::Once;

use log::{Level, LevelFilter, Log, Metadata, Record};

/// A message of an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Name of the instance.
    pub instance: String,
    /// Whether it is a warning, and not a failure or mere information.
    pub warning: bool,
    /// What it says.
    pub text: String,
}

/// An FMU that talks at every step is not kept to the end.
const MOST_KEPT: usize = 100;

thread_local! {
    /// An instance is called by one thread at a time, and talks within a call.
    static MESSAGES: RefCell<Vec<Message>> = const { RefCell::new(Vec::new()) };
}

struct Collector;

impl Log for Collector {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &Record<'_>) {
        let message = Message {
            instance: record.target().to_owned(),
            warning: record.level() == Level::Warn,
            text: record.args().to_string(),
        };
        MESSAGES.with_borrow_mut(|messages| {
            if messages.len() == MOST_KEPT {
                messages.remove(0);
            }
            messages.push(message);
        });
    }

    fn flush(&self) {}
}

/// Collects messages from now on.
pub(crate) fn collect() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // Messages of FMUs come whatever the level is; those of the crate `fmi` are not wanted.
        log::set_max_level(LevelFilter::Off);
        // A program that has a logger of its own gets the messages there.
        let _ = log::set_logger(&Collector);
    });
}

/// Takes the messages of this thread's instances.
pub(crate) fn take() -> Vec<Message> {
    MESSAGES.take()
}

/// The newest message of an instance.
pub(crate) fn newest(instance: &str) -> Option<String> {
    MESSAGES.with_borrow(|messages| {
        let message = messages.iter().rev().find(|m| m.instance == instance)?;
        Some(message.text.clone())
    })
}
