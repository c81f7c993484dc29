//! Supervisor side: a worker process with its limits, its tasks and its replies.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{self, Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use fmu_host::{ProcessOwned, SharedMemory};
use serde::{Deserialize, Serialize};

use crate::channel::{FOLDER, RECORD, REPLIES, Receiver, SUPERVISOR, Sender, TASKS, WORDS, decode};
use crate::record::{Call, Record};

/// What a process may use before it is killed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Limits {
    /// Time of each call of a foreign function.
    pub call: Option<Duration>,
    /// Time after a task was sent.
    pub task: Option<Duration>,
    /// Resident memory in bytes; only Linux tells how much a process uses.
    pub memory: Option<u64>,
}

/// What a worker has done.
#[derive(Debug, Clone, Copy)]
pub enum Event {
    /// It has replied; [`Worker::reply`] returns the reply.
    Replied,
    /// It has ended, and all its replies were received.
    Ended(Ended),
}

/// How a process ended. Its text follows a subject: "fmi2DoStep" + " " + "was ended by signal 6, abort".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// By itself, or by a signal.
    Exited(ExitStatus),
    /// Killed after this time.
    TimedOut(Duration),
    /// Killed when it used this many bytes of memory.
    OutOfMemory(u64),
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let status = match self {
            Self::Exited(status) => status,
            Self::TimedOut(limit) => {
                let seconds = limit.as_secs_f64();
                return write!(f, "did not return within {seconds} s and was killed");
            }
            Self::OutOfMemory(bytes) => {
                let gigabytes = *bytes as f64 / 1e9;
                return write!(f, "used more than {gigabytes:.1} GB of memory and was killed");
            }
        };
        #[cfg(unix)]
        if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(status) {
            let name = match signal {
                4 => ", illegal instruction",
                5 => ", trap",
                6 => ", abort",
                8 => ", arithmetic error",
                9 => ", killed",
                7 | 11 => ", illegal memory access",
                15 => ", terminated",
                _ => "",
            };
            return write!(f, "was ended by signal {signal}{name}");
        }
        match status.code() {
            // Windows reports a crash as an exit code, such as 0xC0000005 for an access violation.
            Some(code) if cfg!(windows) && code < 0 => {
                write!(f, "was ended by the exception {code:#010X}")
            }
            Some(code) => write!(f, "exited with code {code} before it had finished"),
            None => status.fmt(f),
        }
    }
}

/// A process that runs foreign code. It and all processes that it has started are killed when this value
/// is dropped. A process that is forked from the one that has started it can neither use nor end it.
#[derive(Debug)]
pub struct Worker {
    process: ProcessOwned<Process>,
    record: Record,
    tasks: Sender,
    replies: Receiver,
    limits: Limits,
    ended: Option<Ended>,
    /// When the last task was sent.
    sent: Instant,
    /// The call in progress, when it was first seen, and whether it was reported as slow.
    call: Call,
    since: Instant,
    is_reported: bool,
    /// When something last happened, and when the memory was last measured.
    active: Instant,
    memory_checked: Instant,
    /// How often it was polled.
    polls: u64,
}

/// The process of a worker and its folder, which end together.
#[derive(Debug)]
struct Process {
    child: Child,
    folder: PathBuf,
}

/// The time after which a call counts as slow.
pub const SLOW: Duration = Duration::from_secs(10);
/// Interval between checks of the memory.
const MEMORY_PERIOD: Duration = Duration::from_millis(20);
/// Shortest and longest pause between two polls.
const PAUSES: [Duration; 2] = [Duration::from_micros(50), Duration::from_millis(4)];

/// After this many polls, the process and its limits are checked even if it has replied.
const POLLS: u64 = 1024;

/// The time after a task in which its reply may come soon.
const SOON: Duration = Duration::from_micros(200);

impl Worker {
    /// Starts a worker. The command is one that calls
    /// [`Service::from_env`](crate::Service::from_env), usually this program with a hidden
    /// command. Ctrl-C does not reach the worker, since this process decides what to do. `session` is a
    /// temporary folder of this process, in which the worker gets a folder for its temporary files. If this
    /// process is killed, the worker removes the session and ends; on Windows, it waits for tasks for good.
    ///
    /// # Errors
    /// The session cannot be written, or the command cannot be started.
    pub fn start(command: &mut Command, session: &Path, limits: Limits) -> io::Result<Self> {
        Self::start_with_input(command, Stdio::null(), session, limits)
    }

    /// Starts a worker that has this standard input, else as [`Worker::start`].
    ///
    /// # Errors
    /// As [`Worker::start`].
    pub fn start_with_input(
        command: &mut Command,
        input: Stdio,
        session: &Path,
        limits: Limits,
    ) -> io::Result<Self> {
        static STARTED: AtomicUsize = AtomicUsize::new(0);
        let folder = session.join(format!("worker-{}", STARTED.fetch_add(1, Relaxed)));
        let create = || {
            fs::create_dir(&folder)?;
            let record = Record::create(&folder.join(RECORD))?;
            let tasks = SharedMemory::create(&folder.join(TASKS), WORDS)?;
            Ok((record, tasks, SharedMemory::create(&folder.join(REPLIES), WORDS)?))
        };
        let (record, tasks, replies) = create().map_err(|error: io::Error| {
            let text = format!("cannot write to the folder {}: {error}", session.display());
            io::Error::new(error.kind(), text)
        })?;
        for variable in [FOLDER, "TMPDIR", "TMP", "TEMP"] {
            command.env(variable, &folder);
        }
        command.env(SUPERVISOR, process::id().to_string());
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(command, 0);
        #[cfg(windows)]
        std::os::windows::process::CommandExt::creation_flags(command, 0x200);
        let child = command.stdin(input).spawn()?;
        let now = Instant::now();
        Ok(Self {
            process: ProcessOwned::new(Process { child, folder }),
            call: record.call(),
            record,
            tasks: Sender::new(tasks),
            replies: Receiver::new(replies),
            limits,
            ended: None,
            sent: now,
            since: now,
            is_reported: false,
            active: now,
            memory_checked: now,
            polls: 0,
        })
    }

    /// The record of its calls.
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// Sends a task. A worker that does not take it, because it has ended, is found by
    /// [`Worker::poll`].
    ///
    /// # Panics
    /// The task cannot be serialized.
    pub fn send<T: Serialize>(&mut self, task: &T) {
        self.send_or_dismiss(Some(task));
    }

    /// Tells the worker that there are no more tasks.
    pub fn dismiss(&mut self) {
        self.send_or_dismiss(None::<&()>);
    }

    fn send_or_dismiss<T: Serialize>(&mut self, task: Option<&T>) {
        let task = postcard::to_allocvec(&task).expect("a task has a known length");
        let process = &mut self.process;
        // The shared files belong to the process that has started the worker.
        if process.is_of_this_process() {
            self.tasks.send(&task, || {
                thread::sleep(PAUSES[0]);
                matches!(process.child.try_wait(), Ok(None))
            });
        }
        self.sent = Instant::now();
        self.active = self.sent;
    }

    /// What the worker has done since the last poll, if anything; the worker is killed if it exceeds a limit. Now and
    /// then this is `None` although more replies wait, so that a worker that replies faster than its replies are
    /// received can be stopped.
    ///
    /// # Errors
    /// The system does not tell the state of the process, or another process has started it.
    pub fn poll(&mut self) -> io::Result<Option<Event>> {
        self.check_process()?;
        self.polls += 1;
        if self.polls.is_multiple_of(POLLS) || !self.replies.receive() {
            if self.ended.is_none() {
                self.ended = self.check_limits()?;
            }
            // It may have replied just before it ended.
            if self.ended.is_none() || !self.replies.receive() {
                return Ok(self.ended.map(Event::Ended));
            }
        }
        self.active = Instant::now();
        Ok(Some(Event::Replied))
    }

    /// Waits until the worker replies or ends.
    ///
    /// # Errors
    /// The system does not tell the state of the process.
    pub fn wait(&mut self) -> io::Result<Event> {
        loop {
            match self.poll()? {
                Some(event) => return Ok(event),
                None => self.pause(),
            }
        }
    }

    /// Waits a moment before the next poll, longer if the worker has not done anything for a while. Just after a task,
    /// this only looks for a reply and lets other threads run, as the reply to a small task takes less than a sleep.
    pub fn pause(&self) {
        let [shortest, longest] = PAUSES;
        if self.sent.elapsed() < SOON {
            if !self.replies.spin() {
                thread::yield_now();
            }
            return;
        }
        thread::sleep((self.active.elapsed() / 8).clamp(shortest, longest));
    }

    /// The reply that was received last.
    ///
    /// # Errors
    /// The reply is of another type, or damaged by a function that writes out of bounds.
    pub fn reply<'a, R: Deserialize<'a>>(&'a self) -> io::Result<R> {
        decode(&self.replies.message)
    }

    /// Whether the call in progress takes long, which is reported once.
    pub fn is_newly_slow(&mut self) -> bool {
        self.update_call();
        let is_new = !self.is_reported && self.record.is_in_call() && self.since.elapsed() >= SLOW;
        self.is_reported |= is_new;
        is_new
    }

    /// Dismisses the worker and waits until it ends. It is killed after this time.
    ///
    /// # Errors
    /// The system does not tell the state of the process.
    pub fn end(&mut self, grace: Duration) -> io::Result<Ended> {
        self.dismiss();
        self.limits.task = Some(self.sent.elapsed() + grace);
        loop {
            if let Event::Ended(ended) = self.wait()? {
                return Ok(ended);
            }
        }
    }

    fn check_process(&self) -> io::Result<()> {
        match self.process.is_of_this_process() {
            true => Ok(()),
            false => Err(io::Error::other("the worker process belongs to another process")),
        }
    }

    fn update_call(&mut self) {
        let call = self.record.call_of_any_thread();
        if call != self.call {
            (self.call, self.since, self.is_reported) = (call, Instant::now(), false);
        }
    }

    /// Whether the process has ended; kills it if it exceeds a limit.
    fn check_limits(&mut self) -> io::Result<Option<Ended>> {
        if let Some(status) = self.process.child.try_wait()? {
            return Ok(Some(Ended::Exited(status)));
        }
        self.update_call();
        let Limits { call, task, memory } = self.limits;
        let call = call.filter(|limit| self.record.is_in_call() && self.since.elapsed() >= *limit);
        let time = call.or(task.filter(|limit| self.sent.elapsed() >= *limit));
        let mut reason = time.map(Ended::TimedOut);
        if let Some(limit) = memory
            && self.memory_checked.elapsed() >= MEMORY_PERIOD
        {
            self.memory_checked = Instant::now();
            let used = used_memory(self.process.child.id()).filter(|used| *used > limit);
            reason = reason.or(used.map(Ended::OutOfMemory));
        }
        if reason.is_some() {
            if let Some(status) = self.process.child.try_wait()? {
                return Ok(Some(Ended::Exited(status)));
            }
            self.kill()?;
        }
        Ok(reason)
    }

    /// Kills the process, whose replies until then can still be received.
    ///
    /// # Errors
    /// The system does not tell the state of the process, or another process has started it.
    pub fn kill(&mut self) -> io::Result<()> {
        self.check_process()?;
        self.process.child.kill()?;
        self.ended = Some(Ended::Exited(self.process.child.wait()?));
        Ok(())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended already; then there is usually nothing left to kill in its group.
        let _ = self.child.kill();
        let _ = self.child.wait();
        #[cfg(unix)]
        {
            use rustix::process::{Pid, Signal, kill_process_group};
            let group = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
            let _ = group.map(|group| kill_process_group(group, Signal::KILL));
        }
        // What cannot be removed now is removed with the session.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Resident memory of a process in bytes.
fn used_memory(process: u32) -> Option<u64> {
    /// The usual size of a page. Where pages are larger, a process may use more than its limit.
    const PAGE: u64 = 4096;
    let text = fs::read_to_string(format!("/proc/{process}/statm")).ok()?;
    let pages: u64 = text.split(' ').nth(1)?.parse().ok()?;
    Some(pages * PAGE)
}

/// The memory in bytes that the processes of this machine, or of this container, may use together. Only
/// Linux tells it.
pub fn available_memory() -> Option<u64> {
    let limits = ["/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"];
    let limits =
        limits.iter().filter_map(|file| fs::read_to_string(file).ok()?.trim().parse().ok());
    let machine = fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let total = machine.lines().find_map(|line| {
        let kilobytes = line.strip_prefix("MemTotal:")?.trim().strip_suffix("kB")?;
        Some(1024 * kilobytes.trim().parse::<u64>().ok()?)
    });
    limits.chain(total).min()
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_worker_that_replies_all_the_time_is_looked_at_and_killed_at_its_limit() {
        let session = std::env::temp_dir().join(format!("fmu-worker-{}", process::id()));
        fs::create_dir(&session).unwrap();
        let limits = Limits { task: Some(Duration::ZERO), ..Limits::default() };
        let mut worker = Worker::start(Command::new("sleep").arg("60"), &session, limits).unwrap();
        let mut replies =
            Sender::new(SharedMemory::open(&worker.process.folder.join(REPLIES)).unwrap());
        for _ in 0..=POLLS {
            replies.send(&[1], || true);
            worker.poll().unwrap();
        }
        assert!(matches!(worker.ended, Some(Ended::TimedOut(_))));
        drop(worker);
        fs::remove_dir(&session).unwrap();
    }
}
