//! The report of a call of an FMU that failed, or that has ended its process.

use std::fmt;

use fmu_worker::{Record, Worker};
use serde::{Deserialize, Serialize};

use crate::exchange::OPERATIONS;

/// A failed call of an FMU.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Name of the component.
    pub component: String,
    /// File name of the FMU.
    pub fmu: String,
    /// The FMI function; empty if the master cannot integrate the equations.
    pub function: &'static str,
    /// The purpose of the call: variables and values, or a step.
    pub what: String,
    /// The communication point (s), once the simulation runs.
    pub time: Option<f64>,
    /// The outcome, such as `returned fmi2Error`.
    pub outcome: String,
    /// What the FMU logged about it.
    pub message: Option<String>,
    /// The time (s) that the FMU has reached, if it did not fail but asked to end the simulation.
    pub ended: Option<f64>,
}

/// Which call has failed, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "see the failure")]
pub struct Call {
    pub component: String,
    pub function: String,
    pub time: Option<f64>,
}

impl Failure {
    /// Which call has failed.
    pub fn call(&self) -> Call {
        let (component, function) = (self.component.clone(), self.function.to_owned());
        Call { component, function, time: self.time }
    }

    /// The call in progress in a record as a failure with this outcome, if there is one. `components` are
    /// the names of the components and of their files.
    pub fn recorded(
        record: &Record,
        components: &[(String, String)],
        outcome: &str,
    ) -> Option<Self> {
        let last = record.snapshot();
        let (function, operation) = (last.function?.name()?, last.function?.operation()?);
        let (component, fmu) = components.get(last.component).cloned().unwrap_or_default();
        let message = match last.message.as_str() {
            "" => None,
            text if last.is_message_of_call => Some(text.to_owned()),
            text => Some(format!("the last log message, of an earlier call, is {text:?}")),
        };
        Some(Self {
            component,
            fmu,
            function,
            what: match operation {
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
            },
            time: last.time,
            outcome: outcome.to_owned(),
            message,
            ended: None,
        })
    }

    /// What failed, without the words of the FMU, which may differ from run to run.
    pub fn event(&self) -> String {
        let time = self.time.map(|time| format!(" at t = {time:?} s"));
        let (what, time) = (&self.what, time.unwrap_or_default());
        let call = match self.function {
            "" => self.outcome.clone(),
            function => format!("{function} {}", self.outcome),
        };
        format!("{} ({}), {what}{time}: {call}", self.component, self.fmu)
    }

    /// Who has ended the simulation, when and why, if it is no failure.
    pub fn end(&self) -> Option<String> {
        let Self { component, fmu, message, .. } = self;
        let reason = message.iter().map(|message| format!(": {message}"));
        let reason = reason.collect::<String>();
        Some(format!("{component} ({fmu}) ended the simulation at t = {:?} s{reason}", self.ended?))
    }

    /// Adds the communication point.
    pub(crate) fn at(mut self: Box<Self>, time: f64) -> Box<Self> {
        self.time = Some(time);
        self
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let event = self.event();
        match &self.message {
            Some(message) => write!(f, "{event}: {message}"),
            None => write!(f, "{event}; the FMU logged no reason"),
        }
    }
}

impl std::error::Error for Failure {}

/// The end of a worker process.
pub(crate) struct Crash {
    /// What happened, without the words of the FMU.
    pub(crate) event: String,
    /// What happened, with the words of the FMU.
    pub(crate) text: String,
    /// The communication point (s).
    pub(crate) time: Option<f64>,
    /// The call, if one was in progress.
    pub(crate) call: Option<Call>,
}

impl Crash {
    /// The call in which a worker has ended, and how. `components` as in [`Failure::recorded`].
    pub(crate) fn new(worker: &Worker, components: &[(String, String)], how: &str) -> Self {
        let record = worker.record();
        let failure = Failure::recorded(record, components, how);
        let outside = || format!("the worker process {how}, outside of the calls of an FMU");
        Self {
            event: failure.as_ref().map_or_else(outside, Failure::event),
            time: record.time(),
            call: failure.as_ref().map(Failure::call),
            text: failure.map_or_else(outside, |failure| failure.to_string()),
        }
    }
}

/// Warns, once each, of a call that has not returned for long, and of a second process.
pub(crate) fn warn_of(worker: &mut Worker, components: &[(String, String)], warn: &dyn Fn(&str)) {
    if worker.is_newly_slow() {
        let outcome = format!("has not returned for {} s", fmu_worker::SLOW.as_secs());
        let slow = Failure::recorded(worker.record(), components, &outcome);
        slow.iter().for_each(|slow| warn(&format!("still waiting: {}", slow.event())));
    }
    if worker.record().take_forked() {
        warn("an FMU has forked the process, and returned in both; the second process was ended");
    }
}
