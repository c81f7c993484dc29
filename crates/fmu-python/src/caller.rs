//! Who calls the instances of a share: the thread that steps, a thread of its own, or a worker process.

use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use fmu_master::vector::{Outcome, Share, Task};
use fmu_worker::Worker;
use pyo3::prelude::*;

use crate::error::{FmuError, to_exception};
use crate::reply::receive;

/// Who calls the instances of a share. Tasks are sent to all callers before the outcome of the first is received.
pub enum Caller {
    /// The thread that receives the outcome, and its task.
    Receiver(Box<Share>, Option<Task>),
    Thread(ShareThread),
    Process(Box<Worker>),
}

impl Caller {
    /// Sends a task. A caller that is gone is found by [`Caller::receive`].
    pub fn send(&mut self, task: Task) {
        match self {
            Self::Receiver(_, own) => *own = Some(task),
            Self::Thread(thread) => thread.send(task),
            Self::Process(worker) => worker.send(&task),
        }
    }

    /// Waits for the outcome of the task. `names` returns the names of all instances and of their file.
    pub fn receive(&mut self, names: impl FnOnce() -> Vec<(String, String)>) -> PyResult<()> {
        let outcome = match self {
            Self::Receiver(share, task) => task.take().map_or(Ok(()), |task| share.fulfil(&task)),
            Self::Thread(thread) => thread.receive()?,
            Self::Process(worker) => receive(worker, names)?,
        };
        outcome.map_err(|error| to_exception(*error))
    }
}

/// A thread with a share.
pub struct ShareThread {
    /// `None` when the thread is to end.
    tasks: Option<SyncSender<Task>>,
    outcomes: Receiver<Outcome>,
    thread: Option<JoinHandle<()>>,
}

/// The time for which a thread waits without sleeping, as the next task often comes soon.
const SOON: Duration = Duration::from_micros(200);

/// Waits for the next message, if the other end is there.
fn next<T>(messages: &Receiver<T>) -> Option<T> {
    let begin = Instant::now();
    while begin.elapsed() < SOON {
        match messages.try_recv() {
            Ok(message) => return Some(message),
            Err(TryRecvError::Empty) => thread::yield_now(),
            Err(TryRecvError::Disconnected) => return None,
        }
    }
    messages.recv().ok()
}

impl ShareThread {
    /// Starts a thread.
    pub fn new(mut share: Share) -> Self {
        let (tasks, received) = sync_channel(1);
        let (sender, outcomes) = sync_channel(1);
        let thread = thread::spawn(move || {
            while let Some(task) = next(&received) {
                if sender.send(share.fulfil(&task)).is_err() {
                    return;
                }
            }
        });
        Self { tasks: Some(tasks), outcomes, thread: Some(thread) }
    }

    fn send(&self, task: Task) {
        let _ = self.tasks.as_ref().map(|tasks| tasks.send(task));
    }

    fn receive(&self) -> PyResult<Outcome> {
        next(&self.outcomes).ok_or_else(|| FmuError::new_err("a thread has ended early"))
    }
}

impl Drop for ShareThread {
    /// Waits until the thread has freed its instances.
    fn drop(&mut self) {
        self.tasks = None;
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
