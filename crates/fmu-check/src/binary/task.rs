//! What a process that tests a binary is to do, and what it replies.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use fmu_description::FmiVersion;
use fmu_worker::{Calls, Function, Record, Service};
use serde::{Deserialize, Serialize};

use super::values::{Level, Row};
use crate::rule::Rule;

/// The folder of the unpacked FMU in the session.
pub const FMU: &str = "fmu";

/// What the process is to do.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Task {
    pub probe: String,
    /// The element of the interface type under test.
    pub interface: String,
    /// The folder with the model description, and with the folder of the unpacked FMU.
    pub session: PathBuf,
    /// The binary, relative to the folder of the FMU.
    pub binary: String,
    pub level: Level,
    pub steps: usize,
    pub seconds: u64,
    /// Whether the FMU logs more than problems.
    pub logging: bool,
    /// Whether wrong calls crash it.
    pub is_fragile: bool,
    /// Names of variables that are not observed.
    pub ignored: HashSet<String>,
}

/// What the process replies, in any number and order until it is done.
#[derive(Debug, Serialize, Deserialize)]
pub enum Reply {
    /// The name of a rule, and what breaks it.
    Found(String, String),
    /// The name of a variable that cannot be read.
    Unreadable(String),
    /// The number of steps of the default experiment, and their duration in s.
    Ran(usize, f64),
    /// The FMU refuses the excitation of its inputs.
    Refused,
    /// The values at a time (s) of a run.
    Row(f64, Row),
    /// There is no more to come.
    Done,
}

/// Where findings and the progress of the test go.
pub struct Report {
    version: FmiVersion,
    record: Record,
    calls: Mutex<Calls>,
    functions: HashMap<&'static str, Function>,
    service: Mutex<Service>,
}

impl Report {
    pub fn new(service: Service, version: FmiVersion) -> Self {
        let functions = Function::all().map(|(function, name)| (name, function));
        Self {
            version,
            calls: service.record().calls(0).into(),
            record: service.record().clone(),
            functions: functions.collect(),
            service: service.into(),
        }
    }

    pub fn call(&self, name: &str) {
        let function = self.functions.get(name).copied();
        lock(&self.calls).begin(function.or(Some(Function::LOADING)));
    }

    /// Records what the test is about to do, such as `after fmi2Reset`.
    pub fn stage(&self, text: impl AsRef<str>) {
        self.record.stage(&in_version(text.as_ref(), self.version));
    }

    pub fn log(&self, text: &str) {
        self.record.log(&text.replace(['\n', '\r'], " "));
    }

    pub fn time(&self, time: f64) {
        self.record.at(time);
    }

    pub fn find(&self, rule: &Rule, text: impl AsRef<str>) {
        self.found(rule, &in_version(text.as_ref(), self.version));
    }

    /// Reports the failure of a test, with its stage and the message logged last.
    pub fn fail(&self, rule: &Rule, text: &str) {
        let (text, now) = (in_version(text, self.version), self.record.now());
        let stage = match now.stage.as_str() {
            stage if text.contains(stage) => String::new(),
            stage => format!(" {stage}"),
        };
        self.found(rule, &format!("{text}{stage}{}", logged(&now.message)));
    }

    fn found(&self, rule: &Rule, text: &str) {
        let text = text.replace(['\n', '\r'], " ");
        self.reply(&Reply::Found(rule.id.to_owned(), text));
    }

    pub fn reply(&self, reply: &Reply) {
        lock(&self.service).reply(reply);
    }
}

fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The end of a message that quotes the message that the FMU logged last.
pub fn logged(message: &str) -> String {
    match message {
        "" => String::new(),
        message => format!("; the FMU logged last: {message}"),
    }
}

/// The names of FMI 2.0 in a text, as they are in a version of FMI.
pub fn in_version(text: &str, version: FmiVersion) -> String {
    const NAMES: [[&str; 2]; 14] = [
        ["fmi2Instantiate", "fmi3Instantiate"],
        ["fmi2GetRealOutputDerivatives", "fmi3GetOutputDerivatives"],
        ["fmi2GetReal", "fmi3GetFloat64"],
        ["fmi2SetReal", "fmi3SetFloat64"],
        ["fmi2GetInteger", "fmi3GetInt32"],
        ["fmi2SetInteger", "fmi3SetInt32"],
        ["fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"],
        ["fmi2NewDiscreteStates", "fmi3UpdateDiscreteStates"],
        ["fmi2SetupExperiment", "fmi3EnterInitializationMode"],
        ["FMUstate", "FMUState"],
        ["DeSerialize", "Deserialize"],
        [
            "providesDirectionalDerivative",
            "providesDirectionalDerivatives",
        ],
        ["the GUID", "the instantiationToken"],
        ["fmi2", "fmi3"],
    ];
    let rename = |text: String, [old, new]: &[&str; 2]| text.replace(old, new);
    match version {
        FmiVersion::Fmi2 => text.to_owned(),
        FmiVersion::Fmi3 => NAMES.iter().fold(text.to_owned(), rename),
    }
}
