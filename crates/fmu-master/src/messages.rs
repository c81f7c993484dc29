//! The log messages of the FMUs in a simulation.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use fmu_file::text::plain;
use fmu_host::{Logged, Status};
use fmu_worker::{Call, Record};
use serde::{Deserialize, Serialize};

/// A log message of an instance.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Message {
    /// Name of the instance.
    pub instance: String,
    /// Whether it reports a problem rather than mere information.
    pub warning: bool,
    /// Its text.
    pub text: String,
    /// How many times it was logged.
    pub times: u64,
    /// The call in which it was logged last.
    call: Call,
}

/// Maximum number kept, in case an FMU logs at every step.
const MAX_MESSAGES: usize = 100;
/// Maximum length of a message.
const MAX_CHARACTERS: usize = 1000;

/// The messages of a simulation. Clones share them, since an FMU may log from its own threads.
#[derive(Debug, Clone, Default)]
pub struct Messages(Arc<Shared>);

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
        Self(Arc::new(Shared { kept: Mutex::default(), record, only_problems: false }))
    }

    /// The same, from FMUs that are asked for warnings and errors only, if they can be: other messages take time, and a
    /// run of a sweep that succeeds shows none.
    pub(crate) fn of_problems(record: Record) -> Self {
        Self(Arc::new(Shared { kept: Mutex::default(), record, only_problems: true }))
    }

    pub(crate) fn only_problems(&self) -> bool {
        self.0.only_problems
    }

    /// Takes the messages logged so far.
    pub fn take(&self) -> Vec<Message> {
        std::mem::take(&mut self.kept())
    }

    fn kept(&self) -> MutexGuard<'_, Vec<Message>> {
        self.0.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn record(&self) -> &Record {
        &self.0.record
    }

    fn call(&self) -> Call {
        self.0.record.call()
    }

    /// Stores a message of an instance.
    pub(crate) fn log(&self, instance: &str, logged: &Logged) {
        let text = plain(logged.text.trim_end(), MAX_CHARACTERS);
        self.0.record.log(&text);
        self.keep(instance, logged.status != Status::Ok, text);
    }

    fn keep(&self, instance: &str, warning: bool, text: String) {
        let (mut messages, call) = (self.kept(), self.call());
        let same = |m: &Message| m.text == text && m.instance == instance;
        let mut message = match messages.iter().position(same) {
            Some(index) => messages.remove(index),
            None => Message { instance: instance.to_owned(), warning: false, text, times: 0, call },
        };
        message.warning |= warning;
        message.times += 1;
        message.call = call;
        if messages.len() == MAX_MESSAGES {
            messages.remove(0);
        }
        messages.push(message);
    }

    /// Records that the newest call returned a warning: all messages logged in it become warnings,
    /// whatever their status.
    pub(crate) fn warn(&self, instance: &str, function: &str) {
        let call = self.call();
        let mut explained = false;
        for message in self.kept().iter_mut().filter(|m| m.call == call) {
            message.warning = true;
            explained = true;
        }
        if !explained {
            let version = function.get(..4).unwrap_or_default();
            self.keep(instance, true, format!("{function} returned {version}Warning"));
        }
    }

    /// Takes the messages of the newest call, of this function, as the reason of its failure.
    pub(crate) fn reason(&self, function: &str) -> Option<String> {
        // Some FMUs start their messages with the name of the function.
        let prefix = format!("{function}: ");
        let call = self.call();
        let logged: Vec<Message> = self.kept().extract_if(.., |m| m.call == call).collect();
        let warns = logged.iter().any(|message| message.warning);
        let texts: Vec<&str> = logged
            .iter()
            .filter(|message| message.warning == warns)
            .map(|message| message.text.trim_start_matches(&prefix))
            .collect();
        (!texts.is_empty()).then(|| texts.join("; "))
    }
}
