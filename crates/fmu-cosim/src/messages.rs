//! What FMUs say through their logger, which the crate `fmi` hands to the crate `log`.

use std::cell::{Cell, RefCell};
use std::sync::Once;

use fmu_file::text::plain;
use log::{Level, LevelFilter, Log, Metadata, Record};

/// A message of an instance.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Name of the instance.
    pub instance: String,
    /// Whether it tells of something wrong, and is not mere information.
    pub warning: bool,
    /// What it says.
    pub text: String,
    /// How many times it was said.
    pub times: u64,
    /// The call in which it was said last.
    call: u64,
}

/// An FMU that talks at every step is not kept to the end.
const MOST_KEPT: usize = 100;
/// Nor is a message without end, in characters.
const LONGEST: usize = 1000;

thread_local! {
    /// An instance is called by one thread at a time, and talks within a call.
    static MESSAGES: RefCell<Vec<Message>> = const { RefCell::new(Vec::new()) };
    /// Number of the call that is under way.
    static CALL: Cell<u64> = const { Cell::new(0) };
}

struct Collector;

impl Log for Collector {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &Record<'_>) {
        let text = match record.args().to_string() {
            // What the crate `fmi` makes of it.
            text if text == "NULL" => "a message that is not UTF-8".into(),
            text => plain(text.trim_end(), LONGEST),
        };
        keep(record.target(), record.level() != Level::Info, text);
    }

    fn flush(&self) {}
}

fn keep(instance: &str, warning: bool, text: String) {
    MESSAGES.with_borrow_mut(|messages| {
        let same = |m: &Message| m.text == text && m.instance == instance;
        let mut message = match messages.iter().position(same) {
            Some(index) => messages.remove(index),
            None => Message {
                instance: instance.to_owned(),
                warning: false,
                text,
                times: 0,
                call: 0,
            },
        };
        message.warning |= warning;
        message.times += 1;
        message.call = CALL.get();
        if messages.len() == MOST_KEPT {
            messages.remove(0);
        }
        messages.push(message);
    });
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

/// Takes the messages that the FMUs of this thread's newest run have left, also when it failed.
pub fn messages() -> Vec<Message> {
    MESSAGES.take()
}

/// Notes that a function of an FMU is about to be called.
#[inline]
pub(crate) fn begin_call() {
    CALL.set(CALL.get() + 1);
}

/// Notes that the newest call returned a warning: what was said in it is one, with whatever status.
#[cold]
pub(crate) fn warn(instance: &str, function: &str) {
    let explained = MESSAGES.with_borrow_mut(|messages| {
        let said = messages.iter_mut().filter(|m| m.call == CALL.get());
        said.map(|message| message.warning = true).count() > 0
    });
    if !explained {
        keep(instance, true, format!("{function} returned fmi2Warning"));
    }
}

/// Takes what was said in the newest call, of this function: why it failed.
pub(crate) fn reason(function: &str) -> Option<String> {
    // Some FMUs begin with it, too.
    let prefix = format!("{function}: ");
    let in_call = |message: &Message| message.call == CALL.get();
    let said: Vec<Message> =
        MESSAGES.with_borrow_mut(|messages| messages.extract_if(.., |m| in_call(m)).collect());
    let warns = said.iter().any(|message| message.warning);
    let texts: Vec<&str> = said
        .iter()
        .filter(|message| message.warning == warns)
        .map(|message| message.text.trim_start_matches(&prefix))
        .collect();
    (!texts.is_empty()).then(|| texts.join("; "))
}
