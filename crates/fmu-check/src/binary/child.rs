//! The child process, which runs one test of a binary and replies what it finds.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result};
use fmu_description::xml;
use fmu_description::{FmiVersion, ModelDescription};
use fmu_host::Library;
use fmu_worker::{Calls, Function, Record, Service};
use serde::{Deserialize, Serialize};

use super::inputs::Level;
use super::probes;
use super::subject::Subject;
use super::values::Row;
use crate::Rule;

/// What the child process is to do.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Task {
    /// The name of the test.
    pub probe: String,
    /// The element of the interface type under test.
    pub interface: String,
    /// The file with the model description, and the folder of the unpacked FMU.
    pub model: PathBuf,
    pub folder: PathBuf,
    /// The binary, relative to that folder.
    pub binary: String,
    /// How strongly inputs are excited.
    pub level: Level,
    /// Number of steps of a short run.
    pub steps: usize,
    /// Time limit in seconds.
    pub seconds: u64,
    /// Whether the FMU logs more than problems.
    pub logging: bool,
    /// Whether wrong calls crash it.
    pub is_fragile: bool,
    /// Names of variables that are not observed.
    pub ignored: HashSet<String>,
}

/// What the child process replies, in any number and order until it is done.
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

/// Receives a test of a binary in this process, which [`crate::Probes`] has started, and runs it.
///
/// # Errors
/// The process was not started for a test, or the unpacked FMU cannot be read.
pub fn run() -> Result<()> {
    let service = Service::of_this_process()?;
    let mut service = service.context("it is started by `validate` only")?;
    let task: Task = service.task()?.context("there is no test to run")?;
    let text = std::fs::read_to_string(&task.model)?;
    let root = xml::parse(&text)?;
    let model = ModelDescription::read(&root)?;
    let report = Arc::new(Report::new(service, model.version));
    let probe = probes::find(&task.probe).context("there is no such test")?;
    let trace = Arc::clone(&report);
    let library = Library::load_traced(
        &task.folder.join(&task.binary),
        model.version,
        move |name| {
            trace.call(name);
        },
    );
    let outcome = match &library {
        Ok(library) => {
            let subject = Subject::new(&task, &model, library, &report);
            subject.and_then(|subject| probe.run(&subject))
        }
        Err(error) => Err(error.clone().into()),
    };
    if let Err(error) = outcome {
        // The folder no longer exists when the message is read.
        let text = format!("{error:#}").replace(&format!("{}/", task.folder.display()), "");
        let text = report.explained(&in_version(&text, model.version));
        report.find(probe.rule, text);
    }
    if probe.unloads() {
        settle();
        drop(library);
    }
    report.reply(&Reply::Done);
    Ok(())
}

/// Gives threads that the FMU has left behind the time to end or to wait, since a library whose code runs
/// cannot be unloaded.
fn settle() {
    const USUAL: usize = 2;
    let threads = std::fs::read_dir("/proc/self/task").map_or(0, Iterator::count);
    if threads > USUAL {
        std::thread::sleep(Duration::from_millis(200));
    }
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
    fn new(service: Service, version: FmiVersion) -> Self {
        let record = service.record().clone();
        Self {
            version,
            calls: record.calls(0).into(),
            record,
            functions: Function::all()
                .map(|(function, name)| (name, function))
                .collect(),
            service: service.into(),
        }
    }

    /// Records which function is called next.
    fn call(&self, name: &'static str) {
        let function = self.functions.get(name).copied();
        lock(&self.calls).begin(function.or(Some(Function::LOADING)));
    }

    /// Records what the test is about to do, such as `after fmi2Reset`.
    pub fn stage(&self, text: impl AsRef<str>) {
        self.record.stage(&in_version(text.as_ref(), self.version));
    }

    /// Records a message of the FMU.
    pub fn log(&self, text: &str) {
        self.record.log(&text.replace(['\n', '\r'], " "));
    }

    /// Records the simulation time.
    pub fn time(&self, time: f64) {
        self.record.at(time);
    }

    /// Adds the stage and the message logged last to the text of a finding.
    fn explained(&self, text: &str) -> String {
        let now = self.record.now();
        let stage = match now.stage.as_str() {
            "" => String::new(),
            stage if text.contains(stage) => String::new(),
            stage => format!(" {stage}"),
        };
        format!("{text}{stage}{}", logged(&now.message))
    }

    /// Reports a finding.
    pub fn find(&self, rule: &Rule, text: impl AsRef<str>) {
        let text = in_version(text.as_ref(), self.version);
        let text = text.replace(['\n', '\r'], " ");
        self.reply(&Reply::Found(rule.id.to_owned(), text));
    }

    /// Replies something else.
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
    const NAMES: [(&str, &str); 14] = [
        ("fmi2Instantiate", "fmi3Instantiate"),
        ("fmi2GetRealOutputDerivatives", "fmi3GetOutputDerivatives"),
        ("fmi2GetReal", "fmi3GetFloat64"),
        ("fmi2SetReal", "fmi3SetFloat64"),
        ("fmi2GetInteger", "fmi3GetInt32"),
        ("fmi2SetInteger", "fmi3SetInt32"),
        ("fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"),
        ("fmi2NewDiscreteStates", "fmi3UpdateDiscreteStates"),
        ("fmi2SetupExperiment", "fmi3EnterInitializationMode"),
        ("FMUstate", "FMUState"),
        ("DeSerialize", "Deserialize"),
        (
            "providesDirectionalDerivative",
            "providesDirectionalDerivatives",
        ),
        ("the GUID", "the instantiationToken"),
        ("fmi2", "fmi3"),
    ];
    match version {
        FmiVersion::Fmi2 => text.to_owned(),
        FmiVersion::Fmi3 => NAMES
            .iter()
            .fold(text.to_owned(), |text, (old, new)| text.replace(old, new)),
    }
}
