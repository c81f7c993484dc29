//! Worker side: the tasks of this process, and its replies.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use fmu_host::this_process;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::channel::{
    self, FOLDER, RECORD, REPLIES, Receiver, SUPERVISOR, Sender, TASKS, WORDS, decode,
};
use crate::record::Record;

/// The tasks of this process, which a supervisor has started, and its replies.
#[derive(Debug)]
pub struct Service {
    folder: PathBuf,
    record: Record,
    process: u32,
    tasks: Receiver,
    replies: Sender,
    /// The bytes of the last reply, so that a reply allocates nothing if it is not longer.
    buffer: Vec<u8>,
}

/// Interval between looks at the tasks, and at the room for replies.
const PERIOD: Duration = Duration::from_micros(200);
/// Interval between looks at the supervisor.
const SUPERVISOR_PERIOD: Duration = Duration::from_millis(200);

impl Service {
    /// The service of this process; `None` if it was not started as a worker, or if another process is the worker, as
    /// that of an FMU that starts this program. On Unix, the process ends when its supervisor is gone.
    ///
    /// # Errors
    /// The folder that it shares with the supervisor is not a worker's.
    pub fn from_env() -> io::Result<Option<Self>> {
        let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else { return Ok(None) };
        let service = Self::open(&folder)?;
        let is_worker = service.record.claim();
        if is_worker {
            end_with_supervisor(&folder);
        }
        Ok(is_worker.then_some(service))
    }

    /// Another end of the same channels, for the same thread.
    ///
    /// # Errors
    /// The folder cannot be opened again.
    pub fn another(&self) -> io::Result<Self> {
        Self::open(&self.folder)
    }

    fn open(folder: &Path) -> io::Result<Self> {
        Ok(Self {
            folder: folder.to_owned(),
            record: Record::open(&folder.join(RECORD))?,
            process: this_process(),
            tasks: Receiver::new(channel::open(&folder.join(TASKS), WORDS)?),
            replies: Sender::new(channel::open(&folder.join(REPLIES), WORDS)?),
            buffer: Vec::new(),
        })
    }

    /// The record of calls.
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// Waits for the next task; `None` if there are no more.
    ///
    /// # Errors
    /// The task is of another type.
    pub fn task<T: DeserializeOwned>(&mut self) -> io::Result<Option<T>> {
        let begin = Instant::now();
        while !self.tasks.receive() {
            match begin.elapsed() < PERIOD {
                true if self.tasks.spin() => {}
                true => thread::yield_now(),
                false => thread::sleep(PERIOD),
            }
        }
        decode(&self.tasks.message)
    }

    /// Replies to the task; several replies are received in their order. Waits until the supervisor has
    /// received earlier ones.
    ///
    /// # Panics
    /// The reply cannot be serialized.
    pub fn reply<T: Serialize>(&mut self, reply: &T) {
        if self.process != this_process() {
            self.record.end_second_process();
        }
        self.buffer.clear();
        let buffer = std::mem::take(&mut self.buffer);
        self.buffer = postcard::to_extend(reply, buffer).expect("a reply has a known length");
        self.replies.send(&self.buffer, || {
            thread::sleep(PERIOD);
            true
        });
    }
}

/// Removes the folder of a session, which gets another name first: threads and processes that are just ending may
/// still write to it.
#[cfg(unix)]
fn remove(session: &Path) -> io::Result<()> {
    let left = session.with_extension("left");
    fs::rename(session, &left)?;
    fs::remove_dir_all(left)
}

/// Ends this process when the process that started it is gone, and removes the session.
fn end_with_supervisor(folder: &Path) {
    #[cfg(unix)]
    {
        let supervisor = std::env::var(SUPERVISOR).unwrap_or_default();
        let folder = folder.to_owned();
        thread::spawn(move || {
            while std::os::unix::process::parent_id().to_string() == supervisor {
                thread::sleep(SUPERVISOR_PERIOD);
            }
            let _ = folder.parent().map(remove);
            std::process::exit(1);
        });
    }
    #[cfg(not(unix))]
    let _ = (folder, SUPERVISOR);
}
