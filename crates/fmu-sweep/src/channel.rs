//! Messages from one process to another, in memory that they share. What an FMU prints cannot get in
//! between, and nobody has to wait for the other.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Acquire, Ordering::Relaxed, Ordering::Release};

use fmu_host::SharedMemory;

/// A ring of words. The words before it are the number of words that were sent and that were received
/// since the beginning. A message is its length in bytes, followed by the bytes.
pub(crate) struct Channel(SharedMemory);

const SENT: usize = 0;
const RECEIVED: usize = 1;
const RING: usize = 2;
const CAPACITY: usize = 1 << 13;
/// Longer messages are cut.
const MAX_BYTES: usize = 8 * (CAPACITY - 1);

impl Channel {
    pub(crate) fn create(file: &Path) -> io::Result<Self> {
        SharedMemory::create(file, RING + CAPACITY).map(Self)
    }

    pub(crate) fn open(file: &Path) -> io::Result<Self> {
        let memory = SharedMemory::open(file)?;
        if memory.words().len() != RING + CAPACITY {
            return Err(io::Error::other("it is not a channel"));
        }
        Ok(Self(memory))
    }

    fn place(&self, number: u64) -> &AtomicU64 {
        &self.0.words()[RING + number as usize % CAPACITY]
    }

    /// Sends a message; returns false if there is no room for it until older ones are received.
    pub(crate) fn send(&self, message: &[u8]) -> bool {
        let message = &message[..message.len().min(MAX_BYTES)];
        let words = self.0.words();
        let sent = words[SENT].load(Relaxed);
        let needed = 1 + message.len().div_ceil(8) as u64;
        if sent + needed > words[RECEIVED].load(Acquire) + CAPACITY as u64 {
            return false;
        }
        self.place(sent).store(message.len() as u64, Relaxed);
        for (number, chunk) in (sent + 1..).zip(message.chunks(8)) {
            let mut eight = [0; 8];
            eight[..chunk.len()].copy_from_slice(chunk);
            self.place(number).store(u64::from_le_bytes(eight), Relaxed);
        }
        words[SENT].store(sent + needed, Release);
        true
    }

    /// The next message, if there is one.
    pub(crate) fn receive(&self) -> Option<Vec<u8>> {
        let words = self.0.words();
        let (received, sent) = (words[RECEIVED].load(Relaxed), words[SENT].load(Acquire));
        if received >= sent {
            return None;
        }
        // An FMU that writes out of bounds may have written here.
        let length = (self.place(received).load(Relaxed) as usize).min(MAX_BYTES);
        let end = received + 1 + length.div_ceil(8) as u64;
        let mut message: Vec<u8> = (received + 1..end)
            .flat_map(|number| self.place(number).load(Relaxed).to_le_bytes())
            .collect();
        message.truncate(length);
        words[RECEIVED].store(end, Release);
        Some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_arrive_in_order_and_wait_for_room() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("channel");
        let receiver = Channel::create(&file).unwrap();
        let sender = std::thread::spawn(move || {
            let sender = Channel::open(&file).unwrap();
            for k in 0..3000_usize {
                while !sender.send(&vec![k as u8; k]) {
                    std::thread::yield_now();
                }
            }
        });
        for k in 0..3000_usize {
            let message = loop {
                match receiver.receive() {
                    Some(message) => break message,
                    None => std::thread::yield_now(),
                }
            };
            assert!(message == vec![k as u8; k], "message {k}");
        }
        sender.join().unwrap();
        assert_eq!(receiver.receive(), None);
    }

    #[test]
    fn a_message_that_is_too_long_is_cut() {
        let folder = tempfile::tempdir().unwrap();
        let channel = Channel::create(&folder.path().join("channel")).unwrap();
        assert!(channel.send(&vec![1; 1 << 20]));
        assert!(!channel.send(b"no room"));
        assert_eq!(channel.receive().unwrap().len(), MAX_BYTES);
        assert!(channel.send(b"room"));
        assert_eq!(channel.receive().unwrap(), b"room");
    }
}
