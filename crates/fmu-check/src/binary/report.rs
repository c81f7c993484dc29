//! Reports findings and the progress of a test, in the worker process.

use std::sync::{Mutex, MutexGuard, PoisonError};

use fmu_description::FmiVersion;
use fmu_host::{CallObserver, InterfaceType, ObservedCall};
use fmu_worker::{Calls, Function, Record, Service};

use crate::binary::task::{Reply, logged};
use crate::binary::vocabulary::in_version;
use crate::rule::Rule;

/// Reports a finding unless a condition holds: `check!(subject, "memory": bytes == 0, "{bytes} are left")`.
macro_rules! check {
    ($subject:expr, $rule:literal: $condition:expr, $($text:tt)+) => {
        match $condition {
            true => {}
            false => $subject.report.add_finding($crate::rule::rule!($rule), format!($($text)+)),
        }
    };
}
pub(super) use check;

/// Where findings and the progress of the test go.
pub struct Reporter {
    version: FmiVersion,
    interface_type: InterfaceType,
    record: Record,
    calls: Mutex<Calls>,
    service: Mutex<Service>,
}

/// Records each call. A component that traps ends the process, as native code that crashes does.
impl CallObserver for Reporter {
    fn begin(&self, call: &ObservedCall<'_>) {
        lock(&self.calls).begin(Function::named(call.function).or(Some(Function::LOADING)));
    }

    fn trapped(&self) {
        std::process::abort();
    }
}

impl Reporter {
    pub fn new(service: Service, version: FmiVersion, interface_type: InterfaceType) -> Self {
        Self {
            version,
            interface_type,
            calls: service.record().calls(0).into(),
            record: service.record().clone(),
            service: service.into(),
        }
    }

    /// Records the time (s) of the run.
    pub fn at(&self, time: f64) {
        self.record.at(time);
    }

    /// Records a message that the FMU has logged.
    pub fn log(&self, text: &str) {
        self.record.log(text);
    }

    /// Records what the test is about to do, such as `after fmi2Reset`.
    pub fn stage(&self, text: impl AsRef<str>) {
        self.record.stage(&self.in_version(text.as_ref()));
    }

    pub fn add_finding(&self, rule: &Rule, text: impl AsRef<str>) {
        let text = self.in_version(text.as_ref()).replace(['\n', '\r'], " ");
        self.reply(&Reply::Found(rule.id.to_owned(), text));
    }

    /// Reports the failure of a test, with its stage and the message logged last.
    pub fn fail(&self, rule: &Rule, text: &str) {
        let (text, last) = (self.in_version(text), self.record.snapshot());
        let stage = match last.stage.as_str() {
            stage if text.contains(stage) => String::new(),
            stage => format!(" {stage}"),
        };
        // Once more in this version, it would be wrong.
        let text = format!("{text}{stage}{}", logged(&last.message)).replace(['\n', '\r'], " ");
        self.reply(&Reply::Found(rule.id.to_owned(), text));
    }

    pub fn reply(&self, reply: &Reply) {
        lock(&self.service).reply(reply);
    }

    /// A text with the names of the functions that were called.
    fn in_version(&self, text: &str) -> String {
        in_version(text, self.version, self.interface_type)
    }
}

pub fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}
