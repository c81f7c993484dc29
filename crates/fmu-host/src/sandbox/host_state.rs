//! The host's data of an instance: what the functions that a component imports need, and the memory that it may take.

use std::ffi::c_void;
use std::path::PathBuf;
use std::ptr;
use std::time::Duration;

use wasmtime::{ResourceLimiter, Trap};

use crate::logger::{self, LogMessage};
use crate::outcome::Status;

/// The length at which lines that a component prints are cut.
const LINE: usize = 8192;

/// What the functions that a component imports need.
#[derive(Default)]
pub(super) struct HostState {
    /// The key of the callbacks.
    pub(super) callbacks: usize,
    pub(super) has_logger: bool,
    pub(super) resources: PathBuf,
    pub(super) memory: MemoryLimit,
    /// The start of a line that the component prints, and its status if there is one.
    printed: Vec<u8>,
    unended: Option<Status>,
    /// Handles that components have borrowed from each other, with their tables; `None` where a call began.
    pub(super) borrowed: Vec<Option<(i32, i32)>>,
}

impl HostState {
    /// `memory` is the limit in bytes.
    pub(super) fn new(
        callbacks: *mut c_void,
        has_logger: bool,
        resources: &str,
        memory: usize,
    ) -> Self {
        let (callbacks, resources) = (callbacks.addr(), resources.into());
        Self { callbacks, has_logger, resources, memory: MemoryLimit(memory), ..Self::default() }
    }

    pub(super) fn log(&self, message: LogMessage) {
        if self.has_logger {
            logger::deliver(ptr::without_provenance_mut(self.callbacks), || message);
        }
    }

    /// Logs what the component prints, line by line. A line may come in parts.
    pub(super) fn print(&mut self, status: Status, bytes: &[u8]) {
        for byte in bytes {
            let is_end = *byte == b'\n';
            if !is_end {
                self.printed.push(*byte);
            }
            if is_end || self.printed.len() == LINE {
                self.end_line(status);
            }
        }
        self.unended = (!self.printed.is_empty()).then_some(status);
    }

    /// Logs a line that has no end.
    pub(super) fn flush(&mut self) {
        if let Some(status) = self.unended.take() {
            self.end_line(status);
        }
    }

    fn end_line(&mut self, status: Status) {
        let text = String::from_utf8_lossy(&self.printed).trim_end().to_owned();
        self.printed.clear();
        self.log(LogMessage { instance: None, status, category: Some("output".to_owned()), text });
    }

    /// Says why a call did not return.
    pub(super) fn log_fatal(&mut self, error: &wasmtime::Error, limit: Option<Duration>) {
        self.flush();
        let text = match (error.downcast_ref(), limit) {
            (Some(Trap::Interrupt), Some(limit)) => {
                format!("not done after {} s", limit.as_secs_f64())
            }
            (Some(trap), _) => trap.to_string(),
            (None, _) => error.root_cause().to_string(),
        };
        let category = Some("logStatusFatal".to_owned());
        self.log(LogMessage { instance: None, status: Status::Fatal, category, text });
    }
}

/// The memory that an instance may still take in bytes, with that of its tables.
#[derive(Default)]
pub(super) struct MemoryLimit(usize);

impl MemoryLimit {
    /// Takes memory for something that grows, if its own maximum allows that.
    fn grow(
        &mut self,
        (from, to, maximum): (usize, usize, Option<usize>),
        (what, unit): (&str, usize),
    ) -> wasmtime::Result<bool> {
        if maximum.is_some_and(|maximum| to > maximum) {
            return Ok(false);
        }
        let rest = self.0.checked_sub((to - from).saturating_mul(unit));
        self.0 = rest.ok_or_else(|| {
            wasmtime::Error::msg(format!("it exceeds its memory limit by growing {what}"))
        })?;
        Ok(true)
    }
}

impl ResourceLimiter for MemoryLimit {
    fn memory_growing(
        &mut self,
        from: usize,
        to: usize,
        maximum: Option<usize>,
    ) -> wasmtime::Result<bool> {
        self.grow((from, to, maximum), ("memory", 1))
    }

    fn table_growing(
        &mut self,
        from: usize,
        to: usize,
        maximum: Option<usize>,
    ) -> wasmtime::Result<bool> {
        self.grow((from, to, maximum), ("table", size_of::<usize>()))
    }

    // A component has one or two of each.
    fn memories(&self) -> usize {
        10
    }

    fn tables(&self) -> usize {
        10
    }
}
