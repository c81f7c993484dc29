//! Why a run has failed: a call of an FMU that failed in the worker process, or in which that process has ended, as the
//! supervisor finds it in the record.

use std::fmt;

use anyhow::Error;
use fmu_host::Cause;
use fmu_worker::{Record, Worker};
use serde::{Deserialize, Serialize};

use crate::messages::Message;
use crate::note::Advice;
use crate::recorded_instance::OPERATIONS;

/// Why a run has failed or, if `ended` is given, why an FMU has ended it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunError {
    /// The call that failed; `None` if the run cannot begin, or if the process has ended outside of the calls.
    pub call: Option<FailedCall>,
    /// The outcome of the call, such as `returned fmi2Error`; without a call, the whole reason.
    pub outcome: String,
    /// The communication point (s), once the simulation runs.
    pub time: Option<f64>,
    /// The reason that the FMU logged.
    pub reason: Option<String>,
    /// The time (s) that the FMU has reached, if it did not fail but asked to end the simulation.
    pub ended: Option<f64>,
    /// The advice that follows the text.
    pub advice: Option<Advice>,
    /// All messages of the FMUs.
    pub messages: Vec<Message>,
}

/// A call of an FMU that failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FailedCall {
    /// Name of the component.
    pub component: String,
    /// File name of the FMU.
    pub fmu: String,
    /// The FMI function; empty if the master cannot integrate the equations.
    pub function: String,
    /// The purpose of the call: variables and values, or a step.
    pub purpose: String,
}

impl RunError {
    /// A run that cannot go on, with these messages of the FMUs. The error comes from [`Plan`](crate::Plan) or
    /// [`Simulation`](crate::Simulation).
    pub fn new(error: Error, messages: Vec<Message>) -> Box<Self> {
        Box::new(match error.downcast::<Self>() {
            Ok(failed) => Self { messages, ..failed },
            Err(error) => {
                let advice = Advice::in_error(&error).cloned();
                Self { messages, advice, ..Self::without_call(format!("{error:#}"), None) }
            }
        })
    }

    /// A failed call with this outcome.
    pub(crate) fn in_call(call: FailedCall, outcome: String, reason: Option<String>) -> Self {
        Self { call: Some(call), reason, ..Self::without_call(outcome, None) }
    }

    pub(crate) fn without_call(outcome: String, time: Option<f64>) -> Self {
        let (call, reason, ended, advice) = (None, None, None, None);
        Self { call, outcome, time, reason, ended, advice, messages: Vec::new() }
    }

    /// The call in which a worker process has ended, and how. `components` are the names of the components and of
    /// their files.
    pub fn crash(worker: &Worker, components: &[(String, String)], how: &str) -> Box<Self> {
        let record = worker.record();
        Box::new(Self::recorded(record, components, how).unwrap_or_else(|| {
            let outcome = format!("the worker process {how}, outside of the calls of an FMU");
            Self::without_call(outcome, record.time())
        }))
    }

    /// The call in progress in a record, with this outcome, if there is one.
    fn recorded(record: &Record, components: &[(String, String)], outcome: &str) -> Option<Self> {
        let last = record.snapshot();
        let (function, operation) = (last.function?.name()?, last.function?.operation()?);
        let (component, fmu) = components.get(last.component).cloned().unwrap_or_default();
        let reason = match last.message.as_str() {
            "" => None,
            text if last.is_message_of_call => Some(text.to_owned()),
            text => Some(format!("the last log message, of an earlier call, is {text:?}")),
        };
        let purpose = match operation {
            "load" => "instantiation".to_owned(),
            "do_step" => format!("step of {:?} s", last.step),
            "terminate" | "free_instance" => "end".to_owned(),
            "setup_experiment" | "enter_initialization_mode" | "exit_initialization_mode" => {
                "initialization".to_owned()
            }
            _ if operation.starts_with("instantiate") => "instantiation".to_owned(),
            _ if OPERATIONS.contains(&operation) => "integration".to_owned(),
            _ if operation.starts_with("get_") => "reading outputs".to_owned(),
            _ => "setting inputs and parameters".to_owned(),
        };
        let call = FailedCall { component, fmu, function: function.to_owned(), purpose };
        Some(Self { time: last.time, ..Self::in_call(call, outcome.to_owned(), reason) })
    }

    /// Whether a component that is a function has failed.
    pub(crate) fn is_of_function(&self) -> bool {
        self.call.is_some() && self.outcome == Cause::Raised.to_string()
    }

    /// The failure without the words of the FMU, which may differ from run to run.
    pub fn event(&self) -> String {
        let Some(FailedCall { component, fmu, function, purpose }) = &self.call else {
            return self.outcome.clone();
        };
        let time = self.time.map(|time| format!(" at t = {time:?} s")).unwrap_or_default();
        let call = match function.as_str() {
            "" => self.outcome.clone(),
            function => format!("{function} {}", self.outcome),
        };
        format!("{component} ({fmu}), {purpose}{time}: {call}")
    }

    /// The early end of a run, if an FMU has asked for it.
    pub fn early_end(&self) -> Option<String> {
        let FailedCall { component, fmu, .. } = self.call.as_ref()?;
        let reason = self.reason.iter().map(|reason| format!(": {reason}"));
        let reason = reason.collect::<String>();
        Some(format!("{component} ({fmu}) ended the simulation at t = {:?} s{reason}", self.ended?))
    }

    /// Adds the communication point.
    pub(crate) fn at(mut self: Box<Self>, time: f64) -> Box<Self> {
        self.time = self.time.or(Some(time));
        self
    }
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let event = self.event();
        match (&self.reason, &self.call) {
            (_, None) => f.write_str(&event),
            (Some(reason), _) => write!(f, "{event}: {reason}"),
            (None, _) => write!(f, "{event}; the FMU logged no reason"),
        }
    }
}

impl std::error::Error for RunError {}

/// Warns, once each, of a call that has not returned for long, and of a second process.
pub(crate) fn warn_of_calls(
    worker: &mut Worker,
    components: &[(String, String)],
    warn: &dyn Fn(&str),
) {
    if worker.is_newly_slow() {
        let outcome = format!("has not returned for {} s", fmu_worker::SLOW.as_secs());
        let slow = RunError::recorded(worker.record(), components, &outcome);
        slow.iter().for_each(|slow| warn(&format!("still waiting: {}", slow.event())));
    }
    if worker.record().take_forked() {
        warn("an FMU has forked the process, and returned in both; the second process was ended");
    }
}
