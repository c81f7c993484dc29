//! The report of a test to the parent process: lines in a file, written before each call so that
//! they survive a crash.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result};

use crate::finding::Findings;

/// Maximum number of bytes read of a report.
pub const MAX_BYTES: u64 = 1 << 20;

const CALL: &str = "call ";
const ERROR: &str = "error ";
const WARNING: &str = "warning ";
const END: &str = "end";

/// The child's side.
pub struct Report {
    file: File,
    last_call: Mutex<String>,
}

impl Report {
    /// Opens the file of the parent.
    pub fn open(file: &Path) -> Result<Self> {
        let file = OpenOptions::new()
            .append(true)
            .open(file)
            .context("cannot open the report")?;
        Ok(Self {
            file,
            last_call: Mutex::default(),
        })
    }

    fn line(&self, kind: &str, text: &str) {
        let line = format!("{kind}{}\n", text.replace(['\n', '\r'], " "));
        // A failure cannot be reported here, but the parent notices that the end is missing.
        let _ = (&self.file).write_all(line.as_bytes());
    }

    /// Records which function is called next.
    pub fn call(&self, name: &str) {
        let last = self.last_call.lock();
        let mut last = last.unwrap_or_else(PoisonError::into_inner);
        if *last != name {
            name.clone_into(&mut last);
            self.line(CALL, name);
        }
    }

    /// Reports an error.
    pub fn error(&self, text: &str) {
        self.line(ERROR, text);
    }

    /// Reports a warning.
    pub fn warning(&self, text: &str) {
        self.line(WARNING, text);
    }

    /// Records that the test has finished.
    pub fn end(&self) {
        self.line(END, "");
    }
}

/// The parent's side: the outcome of a test.
#[derive(Default)]
pub struct Outcome {
    last_call: String,
    ended: bool,
}

impl Outcome {
    /// Reads a report and adds its findings.
    pub fn read(text: &str, location: &str, findings: &mut Findings) -> Self {
        let mut outcome = Self::default();
        for line in text.lines() {
            if let Some(call) = line.strip_prefix(CALL) {
                call.clone_into(&mut outcome.last_call);
            } else if let Some(text) = line.strip_prefix(ERROR) {
                findings.error(location, text);
            } else if let Some(text) = line.strip_prefix(WARNING) {
                findings.warning(location, text);
            } else if line == END {
                outcome.ended = true;
            }
        }
        outcome
    }

    /// The call that did not return, if the test did not finish.
    pub fn unfinished(&self) -> Option<&str> {
        let call = match self.last_call.as_str() {
            "" => "the test",
            call => call,
        };
        (!self.ended).then_some(call)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_is_read_as_it_was_written() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let report = Report::open(file.path()).unwrap();
        report.call("fmi2DoStep");
        report.error("a\nb");
        report.warning("c");
        let read = || {
            let mut findings = Findings::default();
            let text = std::fs::read_to_string(file.path()).unwrap();
            (Outcome::read(&text, "x", &mut findings), findings)
        };
        let (outcome, findings) = read();
        assert_eq!(outcome.unfinished(), Some("fmi2DoStep"));
        let texts = findings
            .groups()
            .iter()
            .map(|group| group.kept[0].text.as_str());
        assert!(texts.eq(["a b", "c"]));
        report.end();
        assert_eq!(read().0.unfinished(), None);
    }
}
