//! Supervisor side: the worker processes of a sweep. A process that an FMU ends is replaced by another one, and only the run
//! in progress is lost. A process in which an FMU has had a fatal error is replaced, too.

use std::collections::VecDeque;
use std::io;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use fmu_worker::{Ended, Event, Worker};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::RunError;
use crate::error::warn_of_calls;
use crate::function::{Computed, FunctionCall};

/// How a sweep starts its worker processes.
pub struct Workers<'a> {
    /// Their number.
    pub count: usize,
    /// Starts a process that does the job [`Job::Sweep`](crate::job::Job::Sweep).
    pub start: &'a dyn Fn() -> io::Result<Worker>,
    /// Whether to stop, asked again and again.
    pub is_cancelled: &'a dyn Fn() -> bool,
    /// Receives warnings: of each call that does not return for long, and of a process that an FMU has forked.
    pub warn: &'a dyn Fn(&str),
    /// Makes the functions of each run, with a state of their own, if the system has functions.
    pub functions: Option<&'a dyn Fn() -> Result<RunFunctions>>,
}

/// Computes the outputs of the functions of a run.
pub type RunFunctions = Box<dyn Fn(&FunctionCall) -> Computed>;

/// What a worker replies.
#[derive(Serialize, Deserialize)]
pub(super) enum WorkerReply<R> {
    /// The run in progress needs the outputs of a function.
    Call(FunctionCall),
    /// The task is done.
    Done {
        /// What came of it.
        reply: R,
        /// Whether an FMU must not be called again, so that the worker gets no more tasks.
        is_lost: bool,
    },
}

/// The number of processes that the user asks for; 0 is one per core.
pub fn process_count(asked: usize) -> usize {
    match asked {
        0 => thread::available_parallelism().map_or(1, Into::into),
        count => count,
    }
}

/// The outcome of a task.
pub(crate) enum TaskOutcome<R> {
    /// The reply of the worker.
    Reply(R),
    /// The worker ended.
    Crash(Box<RunError>),
}

/// Why a worker gets no more tasks.
enum End {
    /// Its process has ended.
    Process(Ended),
    /// It has replied that an FMU must not be called again.
    Lost,
}

/// The longest polling interval, and the shortest, used after tasks were handed out and near the end of the sweep.
const PERIOD: Duration = Duration::from_millis(4);
const FIRST_PERIOD: Duration = Duration::from_micros(250);
/// The tasks of a worker are to take less than about this time.
const AHEAD: Duration = Duration::from_millis(32);
/// Maximum number of tasks of a worker.
const MAX_AHEAD: usize = 256;
/// The time that workers have to free their FMUs at the end.
const FAREWELL: Duration = Duration::from_secs(2);
/// The time after the call of a function in which the next one may come soon.
const SOON: Duration = Duration::from_micros(200);

/// The running workers of a sweep, which get tasks of type `T`, reply once to each, and may call functions before.
pub(crate) struct Pool<'a, T> {
    setup: &'a Workers<'a>,
    /// The components and their FMUs.
    names: Vec<(String, String)>,
    busy: Vec<Busy<T>>,
}

/// A worker with its tasks.
struct Busy<T> {
    worker: Worker,
    /// The functions of the run in progress.
    functions: Option<RunFunctions>,
    /// When it last called one.
    called: Option<Instant>,
    /// What it has been asked to do and has not yet replied to, in order.
    tasks: VecDeque<T>,
    /// The number of tasks that it gets ahead.
    ahead: usize,
    /// When it last got its first task, or replied.
    since: Instant,
}

impl<'a, T: Copy + Serialize> Pool<'a, T> {
    pub(crate) fn new(setup: &'a Workers<'a>, names: Vec<(String, String)>) -> Self {
        Self { setup, names, busy: Vec::new() }
    }

    /// Hands out this number of tasks; `keep` receives the outcome of each, in any order, of several tasks at once if they are
    /// short. Returns false if cancelled.
    ///
    /// # Errors
    /// A worker cannot be started or does nothing, or `keep` fails.
    pub(crate) fn run<R: DeserializeOwned>(
        &mut self,
        number: u64,
        mut tasks: impl Iterator<Item = T>,
        mut keep: impl FnMut(Vec<(T, TaskOutcome<R>)>) -> Result<()>,
    ) -> Result<bool> {
        // The tasks that nobody has.
        let mut rest = number;
        let most = self.setup.count.min(number as usize).max(self.busy.len());
        let mut waiting: VecDeque<T> = VecDeque::new();
        let mut pause = FIRST_PERIOD;
        loop {
            if (self.setup.is_cancelled)() {
                return Ok(false);
            }
            pause = (2 * pause).min(PERIOD);
            for index in (0..most).rev() {
                let mut next = || waiting.pop_front().or_else(|| tasks.next());
                let Some(busy) = self.busy.get_mut(index) else {
                    if let Some(task) = next() {
                        waiting.push_front(task);
                        self.start()?;
                    }
                    continue;
                };
                if let Some(end) = busy.collect(&mut keep)? {
                    // Another worker does its tasks, except for the one in progress.
                    let mut busy = self.busy.swap_remove(index);
                    if let End::Process(ended) = end {
                        let how = match ended {
                            // The limit differs between machines.
                            Ended::OutOfMemory(_) => "used too much memory and was killed".into(),
                            ended => ended.to_string(),
                        };
                        let crash = RunError::crash(&busy.worker, &self.names, &how);
                        let Some(task) = busy.tasks.pop_front() else {
                            bail!("{crash}");
                        };
                        keep(vec![(task, TaskOutcome::Crash(crash))])?;
                    }
                    rest += busy.tasks.len() as u64;
                    waiting.extend(busy.tasks);
                    continue;
                }
                // Less and less at the end, so that all workers end at about the same time.
                let share = rest / (2 * self.setup.count as u64);
                // The outputs of functions come by the same way as tasks, so that a task must not be between them.
                let most = if self.setup.functions.is_some() { 1 } else { busy.ahead };
                let ahead = most.min(share.max(1) as usize);
                if ahead < busy.ahead {
                    pause = FIRST_PERIOD;
                }
                while busy.tasks.len() < ahead
                    && let Some(task) = next()
                {
                    rest = rest.saturating_sub(1);
                    if busy.tasks.is_empty() {
                        (busy.since, pause) = (Instant::now(), FIRST_PERIOD);
                    }
                    busy.functions = self.setup.functions.map(|make| make()).transpose()?;
                    busy.worker.send(&task);
                    busy.tasks.push_back(task);
                }
                warn_of_calls(&mut busy.worker, &self.names, self.setup.warn);
            }
            if waiting.is_empty() && self.busy.iter().all(|busy| busy.tasks.is_empty()) {
                match tasks.next() {
                    Some(task) => waiting.push_back(task),
                    None => return Ok(true),
                }
            }
            let is_called = |busy: &Busy<T>| busy.called.is_some_and(|at| at.elapsed() < SOON);
            if self.busy.iter().any(is_called) {
                thread::yield_now();
            } else {
                thread::sleep(pause);
            }
        }
    }

    fn start(&mut self) -> Result<()> {
        self.busy.push(Busy {
            worker: (self.setup.start)().context("cannot start a worker process")?,
            functions: None,
            called: None,
            tasks: VecDeque::new(),
            ahead: 1,
            since: Instant::now(),
        });
        Ok(())
    }
}

impl<T> Pool<'_, T> {
    /// Lets idle workers free their FMUs and end.
    pub(crate) fn dismiss(&mut self) {
        for busy in self.busy.iter_mut().filter(|busy| busy.tasks.is_empty()) {
            busy.worker.dismiss();
        }
    }
}

impl<T> Drop for Pool<'_, T> {
    /// Lets idle workers free their FMUs; the others are killed.
    fn drop(&mut self) {
        let deadline = Instant::now() + FAREWELL;
        self.busy.retain(|busy| busy.tasks.is_empty());
        self.dismiss();
        for mut busy in self.busy.drain(..) {
            let rest = deadline.saturating_duration_since(Instant::now());
            // How it ends no longer matters.
            let _ = busy.worker.end(rest);
        }
    }
}

impl<T: Copy> Busy<T> {
    /// Passes on the replies, and computes the outputs of functions; returns why the worker gets no more tasks, if so. A worker that has soon done more than
    /// half of its tasks gets twice as many from now on; one whose tasks take long gets one at a time.
    fn collect<R: DeserializeOwned>(
        &mut self,
        keep: &mut impl FnMut(Vec<(T, TaskOutcome<R>)>) -> Result<()>,
    ) -> Result<Option<End>> {
        let mut outcomes = Vec::new();
        let mut end = None;
        while end.is_none()
            && let Some(event) = self.worker.poll()?
        {
            match event {
                Event::Ended(how) => end = Some(End::Process(how)),
                Event::Replied => match self.worker.reply::<WorkerReply<R>>()? {
                    WorkerReply::Call(call) => {
                        let functions = self.functions.as_ref();
                        let compute =
                            functions.context("a worker called a function without a task")?;
                        self.worker.send(&compute(&call));
                        self.called = Some(Instant::now());
                    }
                    WorkerReply::Done { reply, is_lost } => {
                        let task = self.tasks.pop_front();
                        let task = task.context("a worker sent a reply without a task")?;
                        outcomes.push((task, TaskOutcome::Reply(reply)));
                        end = is_lost.then_some(End::Lost);
                    }
                },
            }
        }
        let has_replied = !outcomes.is_empty();
        if has_replied {
            keep(outcomes)?;
        }
        if end.is_some() {
            return Ok(end);
        }
        let is_soon = self.since.elapsed() < AHEAD;
        if has_replied {
            if is_soon && 2 * self.tasks.len() < self.ahead {
                self.ahead = (2 * self.ahead).min(MAX_AHEAD);
            }
            self.since = Instant::now();
        } else if !is_soon {
            self.ahead = 1;
        }
        Ok(None)
    }
}
