//! The call that a worker process has in progress, in memory that its supervisor can read even after a crash: written
//! by the worker, read by the supervisor.

use std::cell::RefCell;
use std::collections::HashMap;
use std::io;
use std::num::NonZeroU64;
use std::path::Path;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use fmi_abi::FmiVersion;
use fmu_host::{SharedMemory, tell_crashes};
use serde::{Deserialize, Serialize};

use crate::channel;

/// The call in progress, the simulation time, the stage of the work and the newest log message. Clones
/// share the record. By default, it is ordinary memory of this process.
#[derive(Debug, Clone)]
pub struct Record {
    memory: SharedMemory,
    /// The memory whose first word is the call in progress: in the calls of a thread of several, that of the thread.
    call: SharedMemory,
    /// Whether another process reads it.
    is_shared: bool,
}

/// A call, which differs from all others: the word `CALL`, and the communication point as bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Call {
    word: u64,
    time: u64,
}

/// The contents of a record at one moment.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Snapshot {
    /// The index of the component that is being called.
    pub component: usize,
    /// The function that is being called.
    pub function: Option<Function>,
    /// The communication point (s); `None` before the initialization.
    pub time: Option<f64>,
    /// The communication step (s).
    pub step: f64,
    /// The stage that the work has reached, such as `after fmi2Reset`; empty if that was not recorded.
    pub stage: String,
    /// The newest log message; empty if there is none.
    pub message: String,
    /// Whether the message was logged during the call in progress.
    pub is_message_of_call: bool,
}

/// The word with the number of the call, the index of the component and the function. This word and the next are the
/// first, which are written without a check that they exist.
const CALL: usize = 0;
/// The communication point (s), NaN before the initialization, and the communication step (s), as bits.
const TIME: usize = 1;
const STEP: usize = 2;
/// The words `CALL` and `TIME` when the newest message was logged.
const LOGGED_IN: usize = 3;
const LOGGED_AT: usize = 4;
/// Whether a process that was forked has gone on with the work.
const FORKED: usize = 5;
/// Whether a worker has the record.
const CLAIMED: usize = 6;
/// The newest message and the stage: the length in bytes, then the bytes. Longer texts are cut.
const MESSAGE: usize = 7;
const STAGE: usize = MESSAGE + 1 + MAX_TEXT / 8;
const MAX_TEXT: usize = 1024;
/// Number of words.
const COUNT: usize = THREADS + MAX_THREADS * THREAD_WORDS;
/// The calls of several threads, each in a cache line of its own. While they make calls, the word `CALL` has none.
const THREADS: usize = (STAGE + 1 + MAX_TEXT / 8).next_multiple_of(THREAD_WORDS);
const THREAD_WORDS: usize = 8;
/// How many threads may make calls at the same time.
pub const MAX_THREADS: usize = 64;

/// Bits of the word `CALL` for the function, and for the component.
const FUNCTION_BITS: u32 = 12;
const COMPONENT_BITS: u32 = 20;
/// The bits of the word `CALL` that are not the number of the call.
const NOT_NUMBER: u64 = (1 << (FUNCTION_BITS + COMPONENT_BITS)) - 1;

impl Default for Record {
    fn default() -> Self {
        Self::new(SharedMemory::private(COUNT))
    }
}

impl Record {
    pub(crate) fn create(file: &Path) -> io::Result<Self> {
        SharedMemory::create(file, COUNT).map(Self::new)
    }

    pub(crate) fn open(file: &Path) -> io::Result<Self> {
        let memory = channel::open(file, COUNT)?;
        Ok(Self { call: memory.clone(), memory, is_shared: true })
    }

    fn new(memory: SharedMemory) -> Self {
        let record = Self { call: memory.clone(), memory, is_shared: false };
        record.at(f64::NAN);
        record
    }

    #[inline]
    fn word(&self, index: usize) -> &AtomicU64 {
        &self.memory.words()[index]
    }

    /// Records the calls of a component.
    pub fn calls(&self, component: usize) -> Calls {
        let component = (component as u64) << FUNCTION_BITS & NOT_NUMBER;
        Calls { record: self.clone(), word: self.call().word & !NOT_NUMBER | component }
    }

    /// Records that no call is in progress.
    pub fn end_call(&self) {
        self.calls(0).begin(None);
    }

    /// Records the communication point (s); NaN before the initialization.
    #[inline]
    pub fn at(&self, time: f64) {
        self.memory.first()[TIME].store(time.to_bits(), Relaxed);
    }

    /// Records the communication step (s).
    pub fn step(&self, step: f64) {
        self.word(STEP).store(step.to_bits(), Relaxed);
    }

    /// Records the stage that the work has reached.
    pub fn stage(&self, text: &str) {
        self.write(STAGE, text);
    }

    /// Records a log message.
    pub fn log(&self, text: &str) {
        self.write(MESSAGE, text);
        let Call { word, time } = self.call();
        self.word(LOGGED_IN).store(word, Relaxed);
        self.word(LOGGED_AT).store(time, Relaxed);
    }

    /// Ends this process, which a foreign function has forked, without running anything else; records that it has gone on
    /// with the work.
    #[cold]
    pub fn end_second_process(&self) -> ! {
        self.word(FORKED).store(1, Relaxed);
        #[cfg(unix)]
        {
            use rustix::process::{Signal, getpid, kill_process};
            let _ = kill_process(getpid(), Signal::KILL);
        }
        std::process::abort()
    }

    /// Whether a second process has gone on with the work, after a function has forked this one and returned in
    /// both; true once. The second process ends when it is about to reply.
    pub fn take_forked(&self) -> bool {
        self.word(FORKED).swap(0, Relaxed) == 1
    }

    /// Whether no process had the record before, which is now this process's.
    pub(crate) fn claim(&self) -> bool {
        self.word(CLAIMED).swap(1, Relaxed) == 0
    }

    /// The call in progress, or the newest one: of this thread, if it is one of several that make calls.
    pub fn call(&self) -> Call {
        let of_thread = THREAD.with_borrow(|thread| thread.as_ref().map(Self::newest));
        let word = of_thread.filter(|word| *word != 0).unwrap_or_else(|| self.newest());
        Call { word, time: self.word(TIME).load(Relaxed) }
    }

    /// The word of the newest call.
    fn newest(&self) -> u64 {
        self.call.first()[CALL].load(Relaxed)
    }

    /// A call that another process has in progress: the one of the first of its threads that has one.
    pub(crate) fn call_of_any_thread(&self) -> Call {
        let call = self.call();
        let threads = (0..MAX_THREADS).map(|number| THREADS + number * THREAD_WORDS);
        let mut words = threads.map(|place| self.word(place).load(Relaxed));
        let found = match function(call.word) {
            Some(_) => None,
            None => words.find(|word| function(*word).is_some()),
        };
        Call { word: found.unwrap_or(call.word), ..call }
    }

    /// The record for the calls of a thread of several, by its number.
    ///
    /// # Panics
    /// The number is not less than [`MAX_THREADS`].
    pub fn of_thread(&self, number: usize) -> Self {
        assert!(number < MAX_THREADS, "thread {number} of {MAX_THREADS}");
        let call = self.memory.tail(THREADS + number * THREAD_WORDS);
        let call = call.expect("it is within the record");
        Self { memory: self.memory.clone(), call, is_shared: self.is_shared }
    }

    /// Begins calls of this thread, whose record [`Record::of_thread`] has made. If it ends the process, the record has its
    /// call.
    pub fn begin_thread(&self) {
        THREAD.set(Some(self.clone()));
        if self.is_shared {
            tell_crashes(&self.call, &self.memory);
        }
    }

    /// Ends the calls of this thread.
    pub fn end_thread() {
        THREAD.set(None);
    }

    /// Records that this thread of several has no call in progress.
    pub fn end_call_of_thread(&self) {
        self.call.first()[CALL].store(0, Relaxed);
    }

    /// Whether a call is in progress.
    pub fn is_in_call(&self) -> bool {
        function(self.call_of_any_thread().word).is_some()
    }

    /// The communication point (s); `None` before the initialization.
    pub fn time(&self) -> Option<f64> {
        let time = f64::from_bits(self.word(TIME).load(Relaxed));
        (!time.is_nan()).then_some(time)
    }

    /// The call, the stage and the message at this moment, or when the process ended.
    pub fn snapshot(&self) -> Snapshot {
        let call = self.call_of_any_thread();
        Snapshot {
            component: ((call.word & NOT_NUMBER) >> FUNCTION_BITS) as usize,
            function: function(call.word),
            time: self.time(),
            step: f64::from_bits(self.word(STEP).load(Relaxed)),
            stage: self.read(STAGE),
            message: self.read(MESSAGE),
            is_message_of_call: self.word(LOGGED_IN).load(Relaxed) == call.word
                && self.word(LOGGED_AT).load(Relaxed) == call.time,
        }
    }

    fn write(&self, place: usize, text: &str) {
        let bytes = &text.as_bytes()[..text.len().min(MAX_TEXT)];
        for (index, chunk) in bytes.chunks(8).enumerate() {
            self.word(place + 1 + index).store(channel::to_word(chunk), Relaxed);
        }
        self.word(place).store(bytes.len() as u64, Relaxed);
    }

    fn read(&self, place: usize) -> String {
        // A process that writes out of bounds may have written here.
        let length = (self.word(place).load(Relaxed) as usize).min(MAX_TEXT);
        let words = self.memory.words()[place + 1..].iter();
        let bytes = words.flat_map(|word| word.load(Relaxed).to_le_bytes());
        String::from_utf8_lossy(&Vec::from_iter(bytes.take(length))).into_owned()
    }
}

thread_local! {
    /// The record of the calls of this thread, if it is one of several.
    static THREAD: RefCell<Option<Record>> = const { RefCell::new(None) };
}

/// The function of a word `CALL`.
fn function(call: u64) -> Option<Function> {
    NonZeroU64::new(call & ((1 << FUNCTION_BITS) - 1)).map(Function)
}

/// A function of FMI 2.0 or 3.0 in a record, or the loading of a binary. It is a number that supervisor and
/// worker agree on, since they are the same program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Function(NonZeroU64);

impl Function {
    /// The loading of a binary, which runs foreign code.
    pub const LOADING: Self = Self(NonZeroU64::MIN);

    /// The function of a version that performs an operation, such as `get_float64`.
    pub fn performing(version: FmiVersion, operation: &str) -> Option<Self> {
        let before = FmiVersion::ALL.into_iter().take_while(|other| *other != version);
        let before = before.map(|other| other.functions().len()).sum::<usize>();
        let place =
            version.functions().iter().position(|(_, performed)| *performed == operation)?;
        Self::LOADING.0.checked_add((before + place) as u64 + 1).map(Self)
    }

    /// The function of a name, such as `fmi3GetFloat64`.
    pub fn named(name: &str) -> Option<Self> {
        static NUMBERS: LazyLock<HashMap<&str, NonZeroU64>> = LazyLock::new(|| {
            let numbers = (1..).filter_map(NonZeroU64::new);
            functions().map(|(name, _)| name).zip(numbers).collect()
        });
        NUMBERS.get(name).copied().map(Self)
    }

    /// Its name; `None` if no function has its number, because the record is damaged.
    pub fn name(self) -> Option<&'static str> {
        Some(self.row()?.0)
    }

    /// The operation that it performs, such as `get_float64`.
    pub fn operation(self) -> Option<&'static str> {
        Some(self.row()?.1)
    }

    fn row(self) -> Option<(&'static str, &'static str)> {
        functions().nth(self.0.get() as usize - 1)
    }
}

/// The names of all functions, and the operations that they perform.
fn functions() -> impl Iterator<Item = (&'static str, &'static str)> {
    let rows = FmiVersion::ALL.into_iter().flat_map(FmiVersion::functions);
    let rows = rows.map(|(call, operation)| (call.name, *operation));
    [("loading the binary", "load")].into_iter().chain(rows)
}

/// Records calls of a component. They are numbered without reading the record, so that no call waits for
/// the one before it; the numbers of different components differ, since the words contain the component.
#[derive(Debug)]
pub struct Calls {
    record: Record,
    /// The word `CALL` of the newest call, without its function.
    word: u64,
}

impl Calls {
    /// Records that a function is about to be called, or that none is.
    #[inline]
    pub fn begin(&mut self, function: Option<Function>) {
        self.word = self.word.wrapping_add(NOT_NUMBER + 1);
        self.continue_call(function);
    }

    /// Records in another record from now on, which gets this one in return.
    pub fn exchange(&mut self, record: &mut Record) {
        std::mem::swap(&mut self.record, record);
    }

    /// Records the call of a function that was not called at this communication point since [`Calls::begin`], with the
    /// number of that call.
    #[inline]
    pub fn continue_call(&self, function: Option<Function>) {
        let word = self.word | function.map_or(0, |function| function.0.get());
        self.record.call.first()[CALL].store(word, Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_process_reads_the_call_the_time_the_stage_and_the_message() {
        let worker = Record::default();
        let supervisor = worker.clone();
        assert_eq!((supervisor.snapshot().function, supervisor.time()), (None, None));
        worker.step(0.25);
        worker.stage("first");
        worker.calls(0).begin(Some(Function::LOADING));
        worker.log(&"é".repeat(2000));
        let (call, first) = (supervisor.call(), supervisor.snapshot());
        assert_eq!((first.message.len(), first.is_message_of_call), (MAX_TEXT, true));
        worker.at(1.5);
        let step = Function::performing(FmiVersion::Fmi3, "do_step");
        worker.calls(1_000_000).begin(step);
        assert_ne!(supervisor.call(), call);
        let second = Snapshot {
            component: 1_000_000,
            function: step,
            time: Some(1.5),
            is_message_of_call: false,
            ..first
        };
        assert_eq!(supervisor.snapshot(), second);
        assert_eq!(step.and_then(Function::row), Some(("fmi3DoStep", "do_step")));
        worker.end_call();
        assert!(!supervisor.is_in_call());
        assert_eq!(Function(NonZeroU64::MAX).name(), None, "a damaged record");
    }
}
