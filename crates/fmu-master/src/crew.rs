//! Threads in which components step at the same time, where the order of stepping allows it. The results are the same as
//! without.
//!
//! For each [batch](crate::batches) of a communication step, the thread of the run moves the components of the batch to
//! seats. All threads take components from there until none is left, and the components return. A thread that waits spins
//! for a moment, as the next batch may come soon, and then sleeps.

use std::hint::spin_loop;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::SeqCst};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{self, Scope, Thread};

use fmu_host::this_process;
use fmu_worker::{MAX_THREADS, Record};

use crate::Plan;
use crate::component_instance::{CallResult, ComponentInstance};
use crate::rate::Rate;

/// How often a thread looks for work before it sleeps, unless there is only one processor: some 50 us.
const LOOKS: usize = 2000;

/// Threads, and the components that step in them.
pub(crate) struct Crew<'a> {
    seats: Vec<Mutex<Seat<'a>>>,
    /// The components of the current batch that no thread has taken yet, by their indices, the first one last.
    due: Mutex<Vec<usize>>,
    /// The number of the batch since the beginning of the run.
    batch: AtomicU64,
    /// How many components of the batch have not stepped yet.
    left: AtomicUsize,
    is_over: AtomicBool,
    looks: usize,
    waiting: Vec<Waiting>,
    record: Record,
    process: u32,
}

/// The place of a component.
struct Seat<'a> {
    component: Option<ComponentInstance<'a>>,
    steps: Steps,
    outcome: CallResult,
}

/// The steps of a component in a communication step.
#[derive(Clone, Copy)]
struct Steps {
    rate: Rate,
    k: u64,
    start: f64,
    time: f64,
    step: f64,
}

/// A thread that may sleep; the first one is that of the run.
#[derive(Default)]
struct Waiting {
    thread: OnceLock<Thread>,
    sleeps: AtomicBool,
}

impl Waiting {
    /// Waits until something is so, which the thread that makes it so tells by [`Waiting::wake`].
    fn until(&self, looks: usize, is_so: impl Fn() -> bool) {
        for _ in 0..looks {
            if is_so() {
                return;
            }
            spin_loop();
        }
        while !is_so() {
            self.sleeps.store(true, SeqCst);
            if !is_so() {
                thread::park();
            }
        }
        self.sleeps.store(false, SeqCst);
    }

    fn wake(&self) {
        if self.sleeps.swap(false, SeqCst) {
            self.thread.get().inspect(|thread| thread.unpark());
        }
    }
}

impl<'a> Crew<'a> {
    /// The crew of a run of a plan, if it wants several threads and components may step at the same time.
    pub(crate) fn new(plan: &Plan, record: &Record) -> Option<Arc<Self>> {
        let threads = plan.execution.threads.map_or(1, NonZeroUsize::get);
        let most = plan.batches.iter().map(Vec::len).max().unwrap_or(0);
        let threads = threads.min(most).min(MAX_THREADS);
        let processors = thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let seat = |index: usize| {
            let rate = plan.components[index].rate;
            let steps = Steps { rate, k: 0, start: plan.experiment.start, time: 0.0, step: 0.0 };
            Mutex::new(Seat { component: None, steps, outcome: Ok(()) })
        };
        let crew = || Self {
            seats: (0..plan.components.len()).map(seat).collect(),
            due: Mutex::default(),
            batch: AtomicU64::new(0),
            left: AtomicUsize::new(0),
            is_over: AtomicBool::new(false),
            looks: if processors > 1 { LOOKS } else { 0 },
            waiting: (0..threads).map(|_| Waiting::default()).collect(),
            record: record.clone(),
            process: this_process(),
        };
        (threads > 1).then(|| Arc::new(crew()))
    }

    /// Starts the threads besides the one of the run, which calls this.
    pub(crate) fn start<'scope>(self: &Arc<Self>, scope: &'scope Scope<'scope, '_>) -> Over<'a>
    where
        'a: 'scope,
    {
        self.enter(0);
        for number in 1..self.waiting.len() {
            let crew = self.clone();
            scope.spawn(move || crew.work(number));
        }
        Over(self.clone())
    }

    fn enter(&self, number: usize) -> Record {
        let record = self.record.of_thread(number);
        record.begin_thread();
        let _ = self.waiting[number].thread.set(thread::current());
        record
    }

    /// Takes components in a thread until the run is over.
    fn work(&self, number: usize) {
        let mut record = self.enter(number);
        let mut batch = 0;
        loop {
            let is_new = || self.batch.load(SeqCst) != batch || self.is_over.load(SeqCst);
            self.waiting[number].until(self.looks, is_new);
            if self.is_over.load(SeqCst) {
                break;
            }
            batch = self.batch.load(SeqCst);
            while self.take(&mut record) {}
        }
        Record::end_thread();
    }

    /// Has the next component step; returns whether there was one.
    fn take(&self, record: &mut Record) -> bool {
        let Some(index) = lock(&self.due).pop() else { return false };
        // Also after a panic, nobody waits for it.
        let _done = Done(self);
        lock(&self.seats[index]).step(record);
        if this_process() != self.process {
            // The other threads exist only in the process that an FMU has forked.
            self.record.end_second_process();
        }
        true
    }

    /// Has some of the components take their steps in communication step `k`, from a time and of a size (s).
    ///
    /// # Errors
    /// The first failure, in the order of the components.
    pub(crate) fn advance(
        &self,
        components: &mut Vec<ComponentInstance<'a>>,
        due: &[usize],
        k: u64,
        (time, step): (f64, f64),
    ) -> CallResult {
        for (seat, component) in self.seats.iter().zip(components.drain(..)) {
            let mut seat = lock(seat);
            seat.component = Some(component);
            seat.steps = Steps { k, time, step, ..seat.steps };
        }
        self.step(due);
        components.extend(self.seats.iter().filter_map(|seat| lock(seat).component.take()));
        due.iter()
            .try_for_each(|&index| std::mem::replace(&mut lock(&self.seats[index]).outcome, Ok(())))
    }

    /// Has components step, and waits until all have.
    fn step(&self, components: &[usize]) {
        self.left.store(components.len(), SeqCst);
        lock(&self.due).extend(components.iter().rev());
        self.batch.fetch_add(1, SeqCst);
        self.waiting[1..].iter().for_each(Waiting::wake);
        let mut record = self.record.of_thread(0);
        while self.take(&mut record) {}
        self.waiting[0].until(self.looks, || self.left.load(SeqCst) == 0);
    }
}

/// A component has stepped.
struct Done<'c, 'a>(&'c Crew<'a>);

impl Drop for Done<'_, '_> {
    fn drop(&mut self) {
        if self.0.left.fetch_sub(1, SeqCst) == 1 {
            self.0.waiting[0].wake();
        }
    }
}

/// Ends the threads of a crew when it is dropped.
pub(crate) struct Over<'a>(Arc<Crew<'a>>);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.is_over.store(true, SeqCst);
        self.0.waiting.iter().for_each(Waiting::wake);
        Record::end_thread();
    }
}

impl Seat<'_> {
    /// Has the component step, whose calls are those of the thread of this record.
    fn step(&mut self, record: &mut Record) {
        let Some(component) = &mut self.component else { return };
        component.recorded.calls.exchange(record);
        self.outcome = component.step_by_itself(self.steps);
        component.recorded.calls.exchange(record);
        record.end_call_of_thread();
    }
}

impl ComponentInstance<'_> {
    /// Takes the steps of a communication step, in which nothing comes from other components.
    fn step_by_itself(&mut self, steps: Steps) -> CallResult {
        let Steps { rate, k, start, time, step } = steps;
        if rate.is_of_system() {
            return self.step_measured(time, step);
        }
        for (number, time) in rate.times(k, start).enumerate() {
            // At the communication point, they were set before.
            let set = if number == 0 { Ok(()) } else { self.set_parameters(time) };
            let stepped = set.and_then(|()| self.step_measured(time, rate.step));
            stepped.map_err(|failure| failure.at(time))?;
        }
        Ok(())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
