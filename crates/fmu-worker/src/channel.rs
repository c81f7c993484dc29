//! Messages between supervisor and worker, in memory that both processes share. Nothing that a foreign function prints
//! gets in between, and a message that was sent before a crash arrives.

use std::hint::spin_loop;
use std::io;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering::Acquire, Ordering::Relaxed, Ordering::Release};
use std::thread;

use fmu_host::SharedMemory;
use serde::Deserialize;

/// The counters of the words that were sent and that were received since the beginning, each in a cache line
/// of its own, so that the two processes do not wait for each other; then a ring of words. A message is its
/// length in bytes, followed by the bytes.
const SENT: usize = 0;
const RECEIVED: usize = 8;
const RING: usize = 16;
const CAPACITY: u64 = 1 << 15;
/// The number of words of a channel.
pub(crate) const WORDS: usize = RING + CAPACITY as usize;
/// A longer message is damaged.
const MAX_BYTES: u64 = 1 << 30;

/// The environment variables with the folder of a worker, and with the process that has started it.
pub(crate) const FOLDER: &str = "FMU_WORKER";
pub(crate) const SUPERVISOR: &str = "FMU_WORKER_SUPERVISOR";
/// The files in this folder.
pub(crate) const RECORD: &str = "record";
pub(crate) const TASKS: &str = "tasks";
pub(crate) const REPLIES: &str = "replies";

/// Opens a file of this many words that another process has created.
pub(crate) fn open(file: &Path, words: usize) -> io::Result<SharedMemory> {
    let memory = SharedMemory::open(file)?;
    match memory.words().len() == words {
        true => Ok(memory),
        false => Err(io::Error::other("it is not the folder of a worker")),
    }
}

/// Up to 8 bytes as a word.
pub(crate) fn to_word(chunk: &[u8]) -> u64 {
    let mut eight = [0; 8];
    eight[..chunk.len()].copy_from_slice(chunk);
    u64::from_le_bytes(eight)
}

/// Reads a message.
pub(crate) fn decode<'a, T: Deserialize<'a>>(message: &'a [u8]) -> io::Result<T> {
    postcard::from_bytes(message)
        .map_err(|error| io::Error::other(format!("a damaged message: {error}")))
}

fn place(memory: &SharedMemory, number: u64) -> &AtomicU64 {
    &memory.words()[RING + (number % CAPACITY) as usize]
}

/// The end of a channel that sends.
#[derive(Debug)]
pub(crate) struct Sender {
    memory: SharedMemory,
    /// The number of words up to which there was room when it was last looked up.
    room: u64,
}

impl Sender {
    pub(crate) fn new(memory: SharedMemory) -> Self {
        Self { memory, room: 0 }
    }

    /// Sends a message. While there is no room for the rest of it, `wait` is called, which returns false
    /// if nobody will receive it; then this returns false.
    pub(crate) fn send(&mut self, message: &[u8], mut wait: impl FnMut() -> bool) -> bool {
        let counters = self.memory.words();
        let mut sent = counters[SENT].load(Relaxed);
        let length = std::iter::once(message.len() as u64);
        for word in length.chain(message.chunks(8).map(to_word)) {
            while sent >= self.room {
                self.room = counters[RECEIVED].load(Acquire) + CAPACITY;
                if sent >= self.room {
                    counters[SENT].store(sent, Release);
                    if !wait() {
                        return false;
                    }
                }
            }
            place(&self.memory, sent).store(word, Relaxed);
            sent += 1;
        }
        counters[SENT].store(sent, Release);
        true
    }
}

/// The end of a channel that receives.
#[derive(Debug)]
pub(crate) struct Receiver {
    memory: SharedMemory,
    /// The length of the message that is being received, once it is known.
    length: Option<usize>,
    /// The message that was received last, or what has arrived of the next one.
    pub(crate) message: Vec<u8>,
}

impl Receiver {
    pub(crate) fn new(memory: SharedMemory) -> Self {
        Self { memory, length: None, message: Vec::new() }
    }

    /// Looks for a message for a few microseconds, in which most calls of FMUs return, unless there is only one processor.
    /// Returns whether one has begun to arrive.
    pub(crate) fn spin(&self) -> bool {
        static LOOKS: LazyLock<usize> = LazyLock::new(|| {
            let processors = thread::available_parallelism().map_or(1, NonZeroUsize::get);
            if processors > 1 { 100 } else { 1 }
        });
        let counters = self.memory.words();
        let received = counters[RECEIVED].load(Relaxed);
        (0..*LOOKS).any(|_| {
            spin_loop();
            counters[SENT].load(Acquire) != received
        })
    }

    /// Receives the next message, if all of it has been sent.
    pub(crate) fn receive(&mut self) -> bool {
        let counters = self.memory.words();
        let received = counters[RECEIVED].load(Relaxed);
        let sent = counters[SENT].load(Acquire);
        // A process that writes out of bounds may have written here.
        let mut words = received..sent.min(received + CAPACITY);
        if self.length.is_none()
            && let Some(first) = words.next()
        {
            let length = place(&self.memory, first).load(Relaxed);
            self.length = Some(length.min(MAX_BYTES) as usize);
            self.message.clear();
        }
        let Some(length) = self.length else { return false };
        while self.message.len() < length
            && let Some(number) = words.next()
        {
            let bytes = place(&self.memory, number).load(Relaxed).to_le_bytes();
            let missing = (length - self.message.len()).min(8);
            self.message.extend_from_slice(&bytes[..missing]);
        }
        counters[RECEIVED].store(words.start, Release);
        let is_whole = self.message.len() == length;
        self.length = self.length.filter(|_| !is_whole);
        is_whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Some of these messages are longer than the channel.
    #[test]
    fn messages_arrive_in_order_and_damaged_memory_does_no_harm() {
        let memory = SharedMemory::private(WORDS);
        let (mut sender, mut receiver) = (Sender::new(memory.clone()), Receiver::new(memory));
        let message = |k: usize| vec![k as u8; 2 * k * k];
        let wait = || {
            std::thread::yield_now();
            true
        };
        std::thread::scope(|scope| {
            scope.spawn(|| (0..400).for_each(|k| assert!(sender.send(&message(k), wait))));
            for k in 0..400 {
                while !receiver.receive() {
                    wait();
                }
                assert!(receiver.message == message(k), "message {k}");
            }
        });
        assert!(!receiver.receive());
        assert!(!sender.send(&[1; 1 << 19], || false), "nobody receives it");
        for word in receiver.memory.words() {
            word.store(u64::MAX / 2, Relaxed);
        }
        assert!(!receiver.receive() && !receiver.receive());
    }
}
