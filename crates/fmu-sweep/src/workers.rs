//! The worker processes of a sweep, and their supervisor. A process that an FMU ends is replaced by
//! another one, and only the run in progress is lost.

use std::collections::VecDeque;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use fmu_cosim::{Failure, Recorder, Supervised};
use fmu_worker::{Ended, Limits};

use crate::channel::Channel;

/// How a sweep starts its worker processes.
pub struct Workers<'a> {
    /// Their number; 0 for one per core.
    pub count: usize,
    /// A folder for the memory that they share with this process.
    pub folder: &'a Path,
    /// The limits of each process; the time is that of each call of an FMU.
    pub limits: Limits,
    /// A command that calls [`Study::work`](crate::Study::work) with this folder.
    pub command: &'a dyn Fn(&Path) -> io::Result<Command>,
    /// Whether to stop, asked again and again.
    pub is_cancelled: &'a dyn Fn() -> bool,
    /// Receives a description of each call that does not return for long.
    pub slow: &'a dyn Fn(&str),
}

impl Workers<'_> {
    /// The number of processes.
    pub fn count(&self) -> usize {
        match self.count {
            0 => thread::available_parallelism().map_or(1, Into::into),
            count => count,
        }
    }
}

/// What came of a task.
pub(crate) enum Outcome {
    /// The answer of the worker.
    Reply(Vec<u8>),
    /// The worker ended.
    Crash(Crash),
}

/// The end of a worker.
pub(crate) struct Crash {
    /// What happened, in the same words in every sweep.
    pub(crate) event: String,
    /// What happened, with the words of the FMU.
    pub(crate) text: String,
    /// The communication point (s).
    pub(crate) time: Option<f64>,
}

/// The files in the folder of a worker.
const CALLS: &str = "calls";
const TASKS: &str = "tasks";
const REPLIES: &str = "replies";

/// Interval between looks at the workers.
const PERIOD: Duration = Duration::from_millis(4);
/// Interval between looks of an idle worker at its tasks, and the first one between looks at it.
const IDLE_PERIOD: Duration = Duration::from_micros(250);
/// The tasks of a worker are to take less than about this time, so that at the end, no other worker has
/// to wait for long.
const AHEAD: Duration = Duration::from_millis(32);
/// Maximum number of tasks of a worker, whose answers the channel can hold.
const MAX_AHEAD: usize = 256;
/// The time that workers have to free their FMUs at the end.
const FAREWELL: Duration = Duration::from_secs(2);

/// The running workers of a sweep.
pub(crate) struct Pool<'a> {
    setup: &'a Workers<'a>,
    /// The components and their FMUs.
    names: Vec<(String, String)>,
    workers: Vec<Worker>,
    /// The number of workers started so far.
    started: u64,
}

impl<'a> Pool<'a> {
    pub(crate) fn new(setup: &'a Workers<'a>, names: Vec<(String, String)>) -> Self {
        Self {
            setup,
            names,
            workers: Vec::new(),
            started: 0,
        }
    }

    /// Hands out tasks; `keep` receives what came of each, in any order. Returns false if cancelled.
    ///
    /// # Errors
    /// A worker cannot be started or does nothing, or `keep` fails.
    pub(crate) fn run(
        &mut self,
        tasks: impl Iterator<Item = u64>,
        mut keep: impl FnMut(u64, Outcome) -> Result<()>,
    ) -> Result<bool> {
        let mut tasks = Tasks::new(tasks);
        let mut pause = IDLE_PERIOD;
        loop {
            if (self.setup.is_cancelled)() {
                return Ok(false);
            }
            while self.workers.len() < self.setup.count() && tasks.is_left() {
                let worker = self.start()?;
                self.workers.push(worker);
            }
            pause = (2 * pause).min(PERIOD);
            for index in (0..self.workers.len()).rev() {
                let worker = &mut self.workers[index];
                worker.collect(&mut keep)?;
                let was_idle = worker.tasks.is_empty();
                worker.hand_out(&mut tasks)?;
                if was_idle && !worker.tasks.is_empty() {
                    pause = IDLE_PERIOD;
                }
                if let Some(call) = worker.process.newly_slow(&self.names) {
                    (self.setup.slow)(&call);
                }
                if let Some(ended) = worker.process.poll()? {
                    self.replace(index, ended, &mut tasks, &mut keep)?;
                }
            }
            if !tasks.is_left() && self.workers.iter().all(|worker| worker.tasks.is_empty()) {
                return Ok(true);
            }
            thread::sleep(pause);
        }
    }

    fn start(&mut self) -> Result<Worker> {
        self.started += 1;
        let folder = self.setup.folder.join(format!("worker-{}", self.started));
        Worker::start(folder, self.setup).context("cannot start a worker process")
    }

    /// Removes a worker that has ended and returns its tasks, except for the one in progress.
    fn replace<I: Iterator<Item = u64>>(
        &mut self,
        index: usize,
        ended: Ended,
        tasks: &mut Tasks<I>,
        keep: &mut impl FnMut(u64, Outcome) -> Result<()>,
    ) -> Result<()> {
        let mut worker = self.workers.swap_remove(index);
        worker.collect(keep)?;
        let crash = worker.crash(&self.names, ended);
        let Some(task) = worker.tasks.pop_front() else {
            bail!("{}", crash.text);
        };
        tasks.returned.extend(worker.tasks.drain(..));
        keep(task, Outcome::Crash(crash))
    }
}

impl Drop for Pool<'_> {
    /// Lets idle workers free their FMUs; the others are killed.
    fn drop(&mut self) {
        self.workers.retain(|worker| worker.tasks.is_empty());
        for worker in &self.workers {
            worker.to.send(&[]);
        }
        let begin = Instant::now();
        while !self.workers.is_empty() && begin.elapsed() < FAREWELL {
            self.workers
                .retain_mut(|worker| matches!(worker.process.poll(), Ok(None)));
            thread::sleep(PERIOD);
        }
    }
}

/// The tasks that are not yet handed out.
struct Tasks<I: Iterator<Item = u64>> {
    returned: VecDeque<u64>,
    rest: std::iter::Peekable<I>,
}

impl<I: Iterator<Item = u64>> Tasks<I> {
    fn new(tasks: I) -> Self {
        Self {
            returned: VecDeque::new(),
            rest: tasks.peekable(),
        }
    }

    fn is_left(&mut self) -> bool {
        !self.returned.is_empty() || self.rest.peek().is_some()
    }

    fn next(&mut self) -> Option<u64> {
        self.returned.pop_front().or_else(|| self.rest.next())
    }
}

struct Worker {
    process: Supervised,
    to: Channel,
    from: Channel,
    /// What it has been asked to do and has not yet answered, in order.
    tasks: VecDeque<u64>,
    /// The number of tasks that it gets ahead.
    ahead: usize,
    /// When it last got its first task, or answered.
    since: Instant,
    folder: PathBuf,
}

impl Worker {
    fn start(folder: PathBuf, setup: &Workers<'_>) -> Result<Self> {
        fs::create_dir(&folder)?;
        let recorder = Recorder::create(&folder.join(CALLS))?;
        let (to, from) = (
            Channel::create(&folder.join(TASKS))?,
            Channel::create(&folder.join(REPLIES))?,
        );
        let child = (setup.command)(&folder)?.spawn()?;
        Ok(Self {
            process: Supervised::new(child, recorder, setup.limits),
            to,
            from,
            tasks: VecDeque::new(),
            ahead: 1,
            since: Instant::now(),
            folder,
        })
    }

    /// Passes on the answers. A worker that has soon done more than half of its tasks gets twice as many
    /// from now on; one whose tasks take long gets one at a time.
    fn collect(&mut self, keep: &mut impl FnMut(u64, Outcome) -> Result<()>) -> Result<()> {
        let tasks = self.tasks.len();
        while let Some(reply) = self.from.receive() {
            let task = self.tasks.pop_front().context("a worker answers unasked")?;
            keep(task, Outcome::Reply(reply))?;
        }
        let is_soon = self.since.elapsed() < AHEAD;
        if self.tasks.len() < tasks {
            if is_soon && 2 * self.tasks.len() < self.ahead {
                self.ahead = (2 * self.ahead).min(MAX_AHEAD);
            }
            self.since = Instant::now();
        } else if !is_soon {
            self.ahead = 1;
        }
        Ok(())
    }

    fn hand_out<I: Iterator<Item = u64>>(&mut self, tasks: &mut Tasks<I>) -> Result<()> {
        if self.tasks.is_empty() {
            self.since = Instant::now();
        }
        while self.tasks.len() < self.ahead {
            let Some(task) = tasks.next() else { break };
            if !self.to.send(&task.to_le_bytes()) {
                bail!("a worker does not take its tasks");
            }
            self.tasks.push_back(task);
        }
        Ok(())
    }

    fn crash(&self, names: &[(String, String)], ended: Ended) -> Crash {
        let recorder = self.process.recorder();
        let how = match ended {
            // The limit differs between machines.
            Ended::OutOfMemory(_) => "used too much memory and was killed".to_owned(),
            ended => ended.to_string(),
        };
        let failure = recorder.failure(names, &how);
        let or_outside = |text: Option<String>| {
            text.unwrap_or_else(|| format!("the process {how}, outside of the calls of an FMU"))
        };
        Crash {
            event: or_outside(failure.as_ref().map(Failure::event)),
            text: or_outside(failure.map(|failure| failure.to_string())),
            time: recorder.time(),
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // The folder of the sweep is removed too.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Does the tasks of a supervisor until it sends an empty one. `work` returns the answer to a task.
///
/// # Errors
/// The folder is not that of a worker.
pub(crate) fn serve(folder: &Path, work: impl Fn(u64, &Recorder) -> Vec<u8>) -> io::Result<()> {
    let recorder = Recorder::open(&folder.join(CALLS))?;
    let tasks = Channel::open(&folder.join(TASKS))?;
    let replies = Channel::open(&folder.join(REPLIES))?;
    loop {
        let Some(task) = tasks.receive() else {
            thread::sleep(IDLE_PERIOD);
            continue;
        };
        let Ok(task) = task.try_into().map(u64::from_le_bytes) else {
            return Ok(());
        };
        let reply = work(task, &recorder);
        while !replies.send(&reply) {
            thread::sleep(IDLE_PERIOD);
        }
    }
}
