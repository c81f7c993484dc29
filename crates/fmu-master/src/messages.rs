//! The log messages of the FMUs in a simulation.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use fmu_file::text::plain;
use fmu_host::{LogMessage, Status};
use fmu_worker::{Call, Record};
use serde::{Deserialize, Serialize};

use crate::observers::Observers;

/// A log message of an instance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Message {
    /// Name of the instance.
    pub instance: String,
    /// How grave it is.
    pub level: Level,
    /// Its log category; empty if the FMU passes none.
    pub category: String,
    /// Its text.
    pub text: String,
    /// How many times it was logged.
    pub times: u64,
    /// The call in which it was logged last.
    call: Call,
    /// How many messages between the one of its kind before it and this one are not kept.
    left_out: u64,
}

/// How grave a message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Level {
    /// Information about what happens.
    Info,
    /// The instance goes on, but something is unusual.
    Warning,
    /// A call has failed.
    Error,
    /// The instance cannot be used any more.
    Fatal,
}

impl Level {
    /// The level of a logged message: the graver one of its status and its category.
    fn of(status: Status, category: &str) -> Self {
        let of_status = match status {
            Status::Ok | Status::Pending => Self::Info,
            Status::Warning | Status::Discard | Status::Unknown(_) => Self::Warning,
            Status::Error => Self::Error,
            Status::Fatal => Self::Fatal,
        };
        let of_category = match category {
            "logStatusWarning" | "logStatusDiscard" => Self::Warning,
            "logStatusError" => Self::Error,
            "logStatusFatal" => Self::Fatal,
            _ => Self::Info,
        };
        of_status.max(of_category)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
            Self::Fatal => "fatal",
        }
    }
}

impl Message {
    /// Whether it reports a problem rather than mere information.
    pub fn is_problem(&self) -> bool {
        self.level > Level::Info
    }
}

/// How many problems, and how many other messages, are kept in case an FMU logs at every step: the first, which usually
/// have the cause, and the last.
const FIRST: usize = 50;
const LAST: usize = 50;
/// Maximum length of a message.
const MAX_CHARACTERS: usize = 1000;

/// The messages of a simulation. Clones share them, since an FMU may log from its own threads.
#[derive(Debug, Clone, Default)]
pub struct Messages {
    shared: Arc<Shared>,
    observers: Observers,
}

#[derive(Debug, Default)]
struct Shared {
    kept: Mutex<Vec<Message>>,
    record: Record,
    /// Whether FMUs are asked for warnings and errors only.
    only_problems: bool,
}

impl Messages {
    /// The messages of a simulation whose calls are recorded.
    pub fn recorded(record: Record) -> Self {
        Self::shared(record, false)
    }

    fn shared(record: Record, only_problems: bool) -> Self {
        let shared = Arc::new(Shared { kept: Mutex::default(), record, only_problems });
        Self { shared, observers: Observers::default() }
    }

    /// The same, of a simulation whose calls are observed.
    pub(crate) fn observed_by(self, observers: Observers) -> Self {
        Self { observers, ..self }
    }

    /// Who observes the calls of the simulation.
    pub(crate) fn observers(&self) -> &Observers {
        &self.observers
    }

    /// The same, from FMUs that are asked for warnings and errors only, if they can be: other messages take time, and a
    /// run of a sweep that succeeds shows none.
    pub(crate) fn of_problems(record: Record) -> Self {
        Self::shared(record, true)
    }

    pub(crate) fn only_problems(&self) -> bool {
        self.shared.only_problems
    }

    /// Takes the messages logged so far. One without an instance says how many are left out in its place.
    pub fn take(&self) -> Vec<Message> {
        with_gaps(std::mem::take(&mut *self.kept()))
    }

    fn kept(&self) -> MutexGuard<'_, Vec<Message>> {
        self.shared.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn record(&self) -> &Record {
        &self.shared.record
    }

    fn call(&self) -> Call {
        self.shared.record.call()
    }

    /// Stores a message of an instance.
    pub(crate) fn log(&self, instance: &str, logged: &LogMessage) {
        let text = plain(logged.text.trim_end(), MAX_CHARACTERS);
        // The record has room for one message, and several threads may log.
        let kept = self.kept();
        self.shared.record.log(&text);
        drop(kept);
        let category = plain(logged.category.as_deref().unwrap_or_default(), MAX_CHARACTERS);
        self.keep(instance, Level::of(logged.status, &category), category, text);
    }

    fn keep(&self, instance: &str, level: Level, category: String, text: String) {
        let (mut kept, call) = (self.kept(), self.call());
        let known = kept.iter().position(|m| m.text == text && m.instance == instance);
        let is_first = |index: &usize| {
            let before = kept[..*index].iter();
            before.filter(|m| m.is_problem() == kept[*index].is_problem()).count() < FIRST
        };
        let place = known.filter(is_first);
        let mut message = match known {
            Some(index) => remove(&mut kept, index),
            None => {
                let instance = instance.to_owned();
                Message { instance, level, category, text, times: 0, call, left_out: 0 }
            }
        };
        message.level = message.level.max(level);
        message.times += 1;
        message.call = call;
        let is_problem = message.is_problem();
        let end = kept.len();
        kept.insert(place.unwrap_or(end), message);
        let mut of_kind = (0..kept.len()).filter(|index| kept[*index].is_problem() == is_problem);
        if let Some(oldest) = of_kind.nth(FIRST)
            && of_kind.nth(LAST - 1).is_some()
        {
            kept[oldest].left_out += kept[oldest].times;
            remove(&mut kept, oldest);
        }
    }

    /// Records that the newest call returned a warning: all messages logged in it become warnings,
    /// whatever their status.
    pub(crate) fn warn(&self, instance: &str, function: &str) {
        let call = self.call();
        let mut explained = false;
        for message in self.kept().iter_mut().filter(|m| m.call == call) {
            message.level = message.level.max(Level::Warning);
            explained = true;
        }
        if !explained {
            let version = function.get(..4).unwrap_or_default();
            let text = format!("{function} returned {version}Warning");
            self.keep(instance, Level::Warning, String::new(), text);
        }
    }

    /// Takes the messages of the newest call, of this function, as the reason of its failure.
    pub(crate) fn reason(&self, function: &str) -> Option<String> {
        // Some FMUs start their messages with the name of the function.
        let prefix = format!("{function}: ");
        let call = self.call();
        let logged = with_gaps(self.kept().extract_if(.., |m| m.call == call));
        let has_problem = logged.iter().any(Message::is_problem);
        let texts: Vec<&str> = logged
            .iter()
            .filter(|message| message.is_problem() == has_problem)
            .map(|message| message.text.trim_start_matches(&prefix))
            .collect();
        (!texts.is_empty()).then(|| texts.join("; "))
    }
}

/// Removes a message; the next of its kind then follows what was left out before it.
fn remove(kept: &mut Vec<Message>, index: usize) -> Message {
    let mut removed = kept.remove(index);
    if let Some(next) = kept[index..].iter_mut().find(|m| m.is_problem() == removed.is_problem()) {
        next.left_out += std::mem::take(&mut removed.left_out);
    }
    removed
}

/// Messages for the user, with a message wherever some are left out.
fn with_gaps(messages: impl IntoIterator<Item = Message>) -> Vec<Message> {
    let all = messages.into_iter().flat_map(|message| {
        let left_out = (message.left_out > 0).then(|| Message {
            instance: String::new(),
            text: format!("{} messages are left out here", message.left_out),
            times: 1,
            left_out: 0,
            ..message.clone()
        });
        left_out.into_iter().chain([message])
    });
    all.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(messages: &Messages) -> Vec<String> {
        let shown = |m: Message| format!("{}{}", m.text, if m.times > 1 { "*" } else { "" });
        messages.take().into_iter().map(shown).collect()
    }

    #[test]
    fn the_first_and_the_last_messages_are_kept_and_the_others_counted() {
        let messages = Messages::default();
        let log = |level, text: &str| messages.keep("a", level, String::new(), text.to_owned());
        log(Level::Error, "cause");
        for number in 0..1000 {
            log(Level::Warning, &format!("{number}"));
            log(Level::Info, "step");
        }
        let found = texts(&messages);
        let numbers = |range: std::ops::Range<i32>| range.map(|n| n.to_string());
        let expected = ["cause".into(), "0".into(), "step*".into()].into_iter();
        let expected = expected.chain(numbers(1..49));
        let expected = expected.chain(["901 messages are left out here".into()]);
        assert_eq!(found, Vec::from_iter(expected.chain(numbers(950..1000))));
        assert!(texts(&messages).is_empty());
    }

    #[test]
    fn the_level_is_the_graver_one_of_status_and_category() {
        let level = |status, category| Level::of(status, category).name();
        assert_eq!(level(Status::Ok, "logEvents"), "info");
        assert_eq!(level(Status::Ok, "logStatusError"), "error");
        assert_eq!(level(Status::Fatal, "logStatusError"), "fatal");
        assert_eq!(level(Status::Discard, ""), "warning");
    }

    #[test]
    fn a_message_that_is_repeated_is_one_of_the_last() {
        let messages = Messages::default();
        for number in 0..200 {
            let keep = |text: String| messages.keep("a", Level::Warning, String::new(), text);
            keep(format!("{number}"));
            keep(if number < 70 { "old" } else { "new" }.to_owned());
        }
        let found = texts(&messages);
        assert_eq!(found[..3], ["0", "old*", "1"]);
        // 202 different ones, of which "new" was logged last and again and again.
        assert_eq!(found[50], "102 messages are left out here");
        assert_eq!(found[99..], ["199", "new*"]);
        assert_eq!(found.len(), 101);
    }
}
