//! The recorder of a trace. Runs in the worker process.

use std::ffi::c_int;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use fmu_file::replace::check_is_file;
use fmu_host::{Direction, LogMessage, ObservedCall, Status};
use serde_json::Value;

use super::VERSION;
use super::element::{States, to_json};

/// Writes the calls of all components to a file: one write to the system for each call.
#[derive(Debug)]
pub(crate) struct Recorder(Mutex<Output>);

#[derive(Debug)]
struct Output {
    file: File,
    begun: Instant,
    /// What is written with the next call: the end of the line before it, and its own beginning.
    text: Vec<u8>,
    calls: u64,
    /// The call whose line is not complete.
    open: Option<u64>,
    states: States,
    failure: Option<io::Error>,
}

impl Recorder {
    /// Creates a file for the calls of components, which have these keys and values in their lines.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn create(path: &Path, components: &[Vec<(&str, Value)>]) -> Result<Self> {
        check_is_file(path)?;
        let cannot = || format!("cannot write {}", path.display());
        let file = File::create(path).with_context(cannot)?;
        let mut output = Output {
            file,
            begun: Instant::now(),
            text: Vec::new(),
            calls: 0,
            open: None,
            states: States::default(),
            failure: None,
        };
        let platform = format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS);
        output.line(&[
            ("trace", VERSION.into()),
            ("program", concat!("cargo-fmu ", env!("CARGO_PKG_VERSION")).into()),
            ("platform", platform.into()),
        ]);
        components.iter().for_each(|component| output.line(component));
        output.write();
        match output.failure.take() {
            Some(error) => Err(error).with_context(cannot),
            None => Ok(Self(Mutex::new(output))),
        }
    }

    fn output(&self) -> MutexGuard<'_, Output> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins the line of a call, and returns the number of the call.
    pub(crate) fn begin(&self, component: &str, call: &ObservedCall<'_>) -> u64 {
        let mut output = self.output();
        output.interrupt();
        output.calls += 1;
        let (number, at) = (output.calls, nanoseconds(output.begun.elapsed()));
        output.open = Some(number);
        output.key("{\"call\":", &number.into());
        output.key(",\"at\":", &at.into());
        output.key(",\"component\":", &component.into());
        output.key(",\"function\":", &call.function.into());
        output.arguments(",\"in\":{", call, |direction| direction != Direction::Out, true);
        output.forget_freed(call);
        output.write();
        number
    }

    /// Completes the line of a call, or begins another one if something has happened meanwhile.
    pub(crate) fn end(
        &self,
        (component, number): (&str, u64),
        call: &ObservedCall<'_>,
        status: Option<c_int>,
        duration: Duration,
    ) {
        let mut output = self.output();
        if output.open != Some(number) {
            output.interrupt();
            output.key("{\"return\":", &number.into());
            output.key(",\"component\":", &component.into());
            output.key(",\"function\":", &call.function.into());
        }
        output.open = None;
        match status {
            Some(status) if call.function.contains("Instantiate") => {
                output.key(",\"instance\":", &(status == 0).into());
            }
            Some(status) => output.key(",\"status\":", &of_status(call.function, status)),
            None => {}
        }
        // After a failure, lists may not be written.
        let has_lists = status.is_none_or(|status| matches!(status, 0 | 1));
        let is_written = |direction| matches!(direction, Direction::Out | Direction::Both);
        output.arguments(",\"out\":{", call, is_written, has_lists);
        output.key(",\"ns\":", &nanoseconds(duration).into());
        output.text.extend_from_slice(b"}\n");
    }

    /// Writes a message that a component has logged.
    pub(crate) fn log(&self, component: &str, message: &LogMessage) {
        let mut output = self.output();
        output.interrupt();
        let status = match message.status {
            Status::Unknown(status) => status.into(),
            status => Value::String(status.to_string().replace("fmi2", "")),
        };
        output.line(&[
            ("log", message.text.as_str().into()),
            ("component", component.into()),
            ("category", message.category.clone().into()),
            ("status", status),
        ]);
        output.write();
    }

    /// Writes the rest.
    ///
    /// # Errors
    /// Something could not be written, now or before.
    pub(crate) fn finish(&self) -> io::Result<()> {
        let mut output = self.output();
        output.write();
        output.failure.take().map_or(Ok(()), Err)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // An error was reported by `finish`, or nobody can be told.
        let _ = self.finish();
    }
}

impl Output {
    fn key(&mut self, key: &str, value: &Value) {
        self.text.extend_from_slice(key.as_bytes());
        self.value(value);
    }

    fn value(&mut self, value: &Value) {
        // Memory can always be written.
        let _ = serde_json::to_writer(&mut self.text, value);
    }

    fn line(&mut self, pairs: &[(&str, Value)]) {
        for (index, (key, value)) in pairs.iter().enumerate() {
            let before = if index == 0 { '{' } else { ',' };
            self.key(&format!("{before}\"{key}\":"), value);
        }
        self.text.extend_from_slice(b"}\n");
    }

    /// Ends the line of a call that goes on, whose results get a line of their own.
    fn interrupt(&mut self) {
        if self.open.take().is_some() {
            self.text.extend_from_slice(b"}\n");
        }
    }

    /// Writes the arguments of some directions, as an object.
    fn arguments(
        &mut self,
        key: &str,
        call: &ObservedCall<'_>,
        is_wanted: impl Fn(Direction) -> bool,
        has_lists: bool,
    ) {
        let wanted = call.arguments().enumerate().filter(|(_, (_, of))| is_wanted(*of));
        let mut before = key;
        for (index, (name, _)) in wanted {
            let begin = self.text.len();
            self.text.extend_from_slice(before.as_bytes());
            self.text.push(b'"');
            self.text.extend_from_slice(name.as_bytes());
            self.text.extend_from_slice(b"\":[");
            let list = self.text.len() - 1;
            let is_list = call.elements(index, &mut |element| {
                let value = to_json(element, &mut self.states);
                let _ = serde_json::to_writer(&mut self.text, &value);
                self.text.push(b',');
            });
            if self.text.last() == Some(&b',') {
                self.text.pop();
            }
            match is_list {
                true if !has_lists => {
                    self.text.truncate(begin);
                    continue;
                }
                true => self.text.push(b']'),
                false => {
                    self.text.remove(list);
                }
            }
            before = ",";
        }
        if before != key {
            self.text.push(b'}');
        }
    }

    /// Forgets the state that a call is about to free, as another one may get its address.
    fn forget_freed(&mut self, call: &ObservedCall<'_>) {
        if call.function.contains("FreeFMU") {
            let states = &mut self.states;
            call.elements(0, &mut |element| states.forget(&element));
        }
    }

    fn write(&mut self) {
        let written = self.file.write_all(&self.text);
        self.failure = self.failure.take().or(written.err());
        self.text.clear();
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    duration.as_nanos().try_into().unwrap_or(u64::MAX)
}

/// The name of a status, or the integer that is none.
pub(crate) fn of_status(function: &str, status: c_int) -> Value {
    match Status::from(status) {
        Status::Unknown(status) => status.into(),
        Status::Pending if function.starts_with("fmi3") => status.into(),
        known => known.to_string().replace("fmi2", function.get(..4).unwrap_or_default()).into(),
    }
}

/// Completes the file of a run whose process has ended, with the way in which it did.
///
/// # Errors
/// The file cannot be written.
pub fn close(path: &Path, ended: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().read(true).append(true).open(path)?;
    let mut last = [b'\n'];
    if file.seek(SeekFrom::End(-1)).is_ok() {
        file.read_exact(&mut last)?;
    }
    let ended = Value::from(ended);
    match last {
        [b'\n'] => writeln!(file, "{{\"ended\":{ended}}}"),
        _ => writeln!(file, ",\"ended\":{ended}}}"),
    }
}
