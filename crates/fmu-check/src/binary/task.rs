//! What the supervisor sends to the worker process of a test, and what the worker replies.

use std::collections::HashSet;
use std::path::PathBuf;

use fmu_host::InterfaceType;
use serde::{Deserialize, Serialize};

use crate::binary::observed::{Row, Trajectory};

/// The folder of the unpacked FMU in the session, and the folder with the working directories of the tests.
pub const FMU: &str = "fmu";

/// The task of a test process.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Task {
    pub probe: String,
    /// The element of the interface type under test.
    pub interface: String,
    /// The folder with the model description, and with the folder of the unpacked FMU.
    pub session: PathBuf,
    /// The binary, relative to the folder of the FMU.
    pub binary: String,
    /// The index of one of [`EXCITATIONS`].
    pub excitation: usize,
    pub steps: usize,
    pub seconds: u64,
    /// Whether the FMU logs more than problems.
    pub logging: bool,
    /// Whether only a few tests are made.
    pub is_quick: bool,
    /// Whether wrong calls crash it.
    pub is_fragile: bool,
    /// Whether a process may have one instance only.
    pub is_alone: bool,
    /// Names of variables that are not observed.
    pub ignored: HashSet<String>,
    /// The rows of the usual run, if the process cannot have an instance for it besides the instance of the test.
    pub usual: Option<Trajectory>,
}

impl Task {
    pub fn interface_type(&self) -> InterfaceType {
        match self.interface.as_str() {
            "ModelExchange" => InterfaceType::ModelExchange,
            "ScheduledExecution" => InterfaceType::ScheduledExecution,
            _ => InterfaceType::CoSimulation,
        }
    }
}

/// A reply of the process. It sends any number, in any order, until it is done.
#[derive(Debug, Serialize, Deserialize)]
pub enum Reply {
    /// The name of a rule, and what breaks it.
    Found(String, String),
    /// What is worth a look, but no fault.
    Hint(String),
    /// The name of a variable that cannot be read.
    Unreadable(String),
    /// How fast the default experiment was run; not if the FMU refuses the excitation of its inputs.
    Ran(Pace),
    /// The values at a time (s) of a run.
    Row(f64, Row),
    /// The test has ended, but for the end of the library.
    Tested,
    /// There is no more to come.
    Done,
}

/// How fast a run was.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Pace {
    /// The number of steps, and their duration in s.
    pub steps: usize,
    pub seconds: f64,
    /// The duration of the longest step or of the initialization in s.
    pub longest: f64,
}

/// The end of a message that quotes the message that the FMU logged last.
pub fn logged(message: &str) -> String {
    match message {
        "" => String::new(),
        message => format!("; the FMU logged last: {message}"),
    }
}
