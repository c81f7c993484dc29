//! The report of a call of an FMU that failed, or that has ended its process.

use std::fmt;

use fmu_worker::Record;

/// A failed call of an FMU.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// Name of the component.
    pub component: String,
    /// File name of the FMU.
    pub fmu: String,
    /// The FMI function.
    pub function: &'static str,
    /// The purpose of the call: variables and values, or a step.
    pub what: String,
    /// The communication point (s), once the simulation runs.
    pub time: Option<f64>,
    /// The outcome, such as `returned fmi2Error`.
    pub outcome: String,
    /// What the FMU logged about it.
    pub message: Option<String>,
}

impl Failure {
    /// The call in progress in a record as a failure with this outcome, if there is one. `components` are
    /// the names of the components and of their files.
    pub fn recorded(
        record: &Record,
        components: &[(String, String)],
        outcome: &str,
    ) -> Option<Self> {
        let now = record.now();
        let (function, operation) = (now.function?.name()?, now.function?.operation()?);
        let (component, fmu) = components.get(now.component).cloned().unwrap_or_default();
        let message = match now.message.as_str() {
            "" => None,
            text if now.is_message_of_call => Some(text.to_owned()),
            text => Some(format!(
                "the last log message, of an earlier call, is {text:?}"
            )),
        };
        Some(Self {
            component,
            fmu,
            function,
            what: match operation {
                "load" => "instantiation".to_owned(),
                "do_step" => format!("step of {:?} s", now.step),
                "terminate" | "free_instance" => "end".to_owned(),
                "setup_experiment" | "enter_initialization_mode" | "exit_initialization_mode" => {
                    "initialization".to_owned()
                }
                _ if operation.starts_with("instantiate") => "instantiation".to_owned(),
                _ if operation.starts_with("get_") => "reading outputs".to_owned(),
                _ => "setting inputs and parameters".to_owned(),
            },
            time: now.time,
            outcome: outcome.to_owned(),
            message,
        })
    }

    /// What failed, without the words of the FMU, which may differ from run to run.
    pub fn event(&self) -> String {
        let Self {
            component,
            fmu,
            what,
            function,
            outcome,
            ..
        } = self;
        let time = self.time.map(|time| format!(" at t = {time:?} s"));
        let time = time.unwrap_or_default();
        format!("{component} ({fmu}), {what}{time}: {function} {outcome}")
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

/// Describes a call that has not returned for long.
pub fn slow(record: &Record, components: &[(String, String)]) -> Option<String> {
    let outcome = format!("has not returned for {} s", fmu_worker::SLOW.as_secs());
    Some(Failure::recorded(record, components, &outcome)?.event())
}
