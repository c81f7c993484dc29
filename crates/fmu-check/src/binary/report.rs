//! The report of a test to the parent process: lines in a file, written before each call so that
//! they survive a crash.

use std::fs::{File, OpenOptions};
use std::io::{Seek, Write};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result};
use fmu_description::FmiVersion;

use super::rules;
use super::tests::Test;
use crate::Rule;

/// Maximum number of bytes read of a report.
pub const MAX_BYTES: u64 = 16 << 20;
/// Maximum number of messages of the FMU in a report.
const MAX_LOGGED: usize = 1000;

/// The name of the report.
pub const FILE: &str = "report";
/// The name of the file with the simulation time.
pub const TIME_FILE: &str = "time";
/// The name of the file with the function that was called last.
pub const CALL_FILE: &str = "call";

const STAGE: &str = "stage ";
const LOGGED: &str = "log ";
const FOUND: &str = "found ";
const VALUE: &str = "value ";
const END: &str = "end";

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

/// The child's side.
pub struct Report {
    version: FmiVersion,
    file: File,
    time: File,
    call: File,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    last_call: &'static str,
    stage: String,
    logged: usize,
    last_logged: String,
}

impl Report {
    /// Opens the files of the parent.
    pub fn open(folder: &Path, version: FmiVersion) -> Result<Self> {
        let open = |name, options: &mut OpenOptions| {
            let file = options.open(folder.join(name));
            file.context("cannot open the report")
        };
        Ok(Self {
            version,
            file: open(FILE, OpenOptions::new().append(true))?,
            time: open(TIME_FILE, OpenOptions::new().write(true))?,
            call: open(CALL_FILE, OpenOptions::new().write(true))?,
            state: Mutex::default(),
        })
    }

    fn line(&self, kind: &str, text: &str) {
        let line = format!("{kind}{}\n", text.replace(['\n', '\r'], " "));
        // A failure cannot be reported here, but the parent notices that the end is missing.
        let _ = (&self.file).write_all(line.as_bytes());
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records which function is called next, in a file of its own: there may be millions of calls.
    pub fn call(&self, name: &'static str) {
        let mut state = self.state();
        if state.last_call != name {
            state.last_call = name;
            overwrite(&self.call, name);
        }
    }

    /// Records what the test is about to do, such as `after fmi2Reset`.
    pub fn stage(&self, text: impl Into<String>) {
        let text = in_version(&text.into(), self.version);
        let mut state = self.state();
        if state.stage != text {
            self.line(STAGE, &text);
            state.stage = text;
        }
    }

    /// Records a message of the FMU.
    pub fn log(&self, text: &str) {
        let mut state = self.state();
        text.clone_into(&mut state.last_logged);
        state.logged += 1;
        if state.logged <= MAX_LOGGED {
            self.line(LOGGED, text);
        }
    }

    /// Adds the stage and the message logged last to the text of a finding.
    pub fn explained(&self, text: &str) -> String {
        let state = self.state();
        let stage = match state.stage.as_str() {
            "" => String::new(),
            stage if text.contains(stage) => String::new(),
            stage => format!(" {stage}"),
        };
        format!("{text}{stage}{}", logged(&state.last_logged))
    }

    /// Records the simulation time, in a file of its own.
    pub fn time(&self, time: f64) {
        // Runs on several threads write it. A failure only makes the message of a crash less precise.
        let _turn = self.state();
        overwrite(&self.time, &time.to_string());
    }

    /// Reports a finding.
    pub fn find(&self, rule: &Rule, text: impl AsRef<str>) {
        let text = in_version(text.as_ref(), self.version);
        self.line(FOUND, &format!("{} {text}", rule.id));
    }

    /// Reports a value to the parent.
    pub fn value(&self, text: &str) {
        self.line(VALUE, text);
    }

    /// Records that the test has finished.
    pub fn end(&self) {
        self.line(END, "");
    }
}

/// Replaces the content of a file by a short text and spaces.
fn overwrite(mut file: &File, text: &str) {
    let _ = file
        .rewind()
        .and_then(|()| file.write_all(format!("{text:<60}").as_bytes()));
}

fn stage(text: &str) -> String {
    match text {
        "" => String::new(),
        text => format!(", {text},"),
    }
}

fn logged(text: &str) -> String {
    match text {
        "" => String::new(),
        text => format!("; the FMU logged last: {text}"),
    }
}

/// The parent's side: the outcome of a test.
#[derive(Default)]
pub struct Outcome {
    /// The function that was called last.
    pub last_call: String,
    stage: String,
    logged: String,
    ended: bool,
    /// Whether the process was killed after its time.
    pub timed_out: bool,
    /// Whether the FMU has logged a problem.
    pub has_message: bool,
    /// The findings, with their texts.
    pub found: Vec<(&'static Rule, String)>,
    /// The values for the parent.
    pub values: Vec<String>,
}

impl Outcome {
    /// Reads a report.
    pub fn read(text: &str) -> Self {
        let mut outcome = Self::default();
        for line in text.lines() {
            if let Some(stage) = line.strip_prefix(STAGE) {
                stage.clone_into(&mut outcome.stage);
            } else if let Some(text) = line.strip_prefix(LOGGED) {
                text.clone_into(&mut outcome.logged);
                outcome.has_message = true;
            } else if let Some(text) = line.strip_prefix(VALUE) {
                outcome.values.push(text.to_owned());
            } else if let Some((id, text)) = line
                .strip_prefix(FOUND)
                .and_then(|found| found.split_once(' '))
                && let Some(rule) = rules::find(id)
            {
                outcome.found.push((rule, text.to_owned()));
            } else if line == END {
                outcome.ended = true;
            }
        }
        outcome
    }

    /// Whether the test itself has failed, besides what else it has found.
    pub fn fails(&self, test: &Test) -> bool {
        let mut found = self.found.iter();
        found.any(|(rule, _)| *rule == test.rule || *rule == test.crash)
    }

    /// The rules of the findings.
    pub fn rules(&self) -> Vec<&'static str> {
        self.found.iter().map(|(rule, _)| rule.id).collect()
    }

    /// Describes the call that did not return, if the test did not finish, given how the process ended.
    pub fn unfinished(&self, how: &str) -> Option<String> {
        let call = match self.last_call.as_str() {
            "" => "the test",
            call => call,
        };
        let (stage, logged) = (stage(&self.stage), logged(&self.logged));
        (!self.ended).then(|| format!("{call}{stage} {how}, expected it to return{logged}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(FILE);
        let call = folder.path().join(CALL_FILE);
        for file in [&file, &call, &folder.path().join(TIME_FILE)] {
            std::fs::write(file, "").unwrap();
        }
        let report = Report::open(folder.path(), FmiVersion::Fmi2).unwrap();
        report.stage("after fmi2Reset");
        report.call("fmi2EnterInitializationMode");
        report.call("fmi2DoStep");
        report.log("broken\n");
        report.find(&rules::RESET, "a\nb");
        report.value("c");
        let read = || Outcome::read(&std::fs::read_to_string(&file).unwrap());
        let mut outcome = read();
        let call = std::fs::read_to_string(call).unwrap();
        call.trim().clone_into(&mut outcome.last_call);
        assert_eq!(
            outcome.unfinished("hung").unwrap(),
            "fmi2DoStep, after fmi2Reset, hung, expected it to return; the FMU logged last: broken "
        );
        assert_eq!(outcome.found, [(&rules::RESET, "a b".to_owned())]);
        assert_eq!(outcome.values, ["c"]);
        report.end();
        assert_eq!(read().unfinished(""), None);
    }
}
