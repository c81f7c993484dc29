//! The rows that are not yet in the file, in memory that outlives a crash.

use std::fs::OpenOptions;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use fmu_host::SharedMemory;

/// A ring of rows. The words before it are: the number of rows, the length of a row, the number of
/// flushes, then for even and for odd flushes the number of rows in the file and its length in bytes.
/// The number of flushes is written last, so that a killed process leaves a consistent pair.
pub(super) struct Pending(SharedMemory);

const ROWS: usize = 0;
const WIDTH: usize = 1;
const FLUSHES: usize = 2;
const FLUSHED: usize = 3;
const RING: usize = 7;
/// Usual size of the ring, in words.
const SIZE: usize = 1 << 14;

impl Pending {
    /// Creates the memory for rows of a number of words, with a file of this length.
    pub(super) fn create(memory: &Path, width: usize, length: u64) -> io::Result<Self> {
        let capacity = (SIZE / width).max(1);
        let pending = Self(SharedMemory::create(memory, RING + capacity * width)?);
        pending.words()[WIDTH].store(width as u64, Relaxed);
        pending.flushed(length);
        Ok(pending)
    }

    /// Opens the memory of another process.
    pub(super) fn open(memory: &Path) -> io::Result<Self> {
        let pending = Self(SharedMemory::open(memory)?);
        let words = pending.words();
        // A process that writes out of bounds may have written here.
        if words.len() <= RING || pending.width() == 0 || pending.width() > words.len() - RING {
            return Err(io::Error::other("it is not a memory of rows"));
        }
        Ok(pending)
    }

    fn words(&self) -> &[AtomicU64] {
        self.0.words()
    }

    fn width(&self) -> usize {
        self.words()[WIDTH].load(Relaxed) as usize
    }

    fn row(&self, row: u64) -> &[AtomicU64] {
        let ring = &self.words()[RING..];
        let width = self.width();
        let place = row as usize % (ring.len() / width) * width;
        &ring[place..place + width]
    }

    /// Adds a row.
    pub(super) fn push(&self, time: f64, values: &[f64]) {
        let rows = &self.words()[ROWS];
        let row = rows.load(Relaxed);
        let numbers = std::iter::once(&time).chain(values);
        for (word, number) in self.row(row).iter().zip(numbers) {
            word.store(number.to_bits(), Relaxed);
        }
        rows.store(row + 1, Relaxed);
    }

    /// Whether another row would overwrite one that is not yet in the file.
    pub(super) fn is_full(&self) -> bool {
        let capacity = (self.words().len() - RING) / self.width();
        self.words()[ROWS].load(Relaxed) - self.in_file().0 >= capacity as u64
    }

    /// Records that all rows are in the file, and its length in bytes.
    pub(super) fn flushed(&self, length: u64) {
        let words = self.words();
        let flushes = words[FLUSHES].load(Relaxed) + 1;
        let place = FLUSHED + 2 * (flushes % 2) as usize;
        words[place].store(words[ROWS].load(Relaxed), Relaxed);
        words[place + 1].store(length, Relaxed);
        words[FLUSHES].store(flushes, Relaxed);
    }

    /// The number of rows in the file, and its length in bytes.
    fn in_file(&self) -> (u64, u64) {
        let words = self.words();
        let place = FLUSHED + 2 * (words[FLUSHES].load(Relaxed) % 2) as usize;
        (words[place].load(Relaxed), words[place + 1].load(Relaxed))
    }

    /// The time of the last row.
    pub(super) fn last(&self) -> Option<f64> {
        let last = self.words()[ROWS].load(Relaxed).checked_sub(1)?;
        Some(f64::from_bits(self.row(last)[0].load(Relaxed)))
    }

    /// The rows that are not in the file.
    pub(super) fn rows(&self, mut each: impl FnMut(f64, &[f64])) {
        let rows = self.words()[ROWS].load(Relaxed);
        let capacity = (self.words().len() - RING) / self.width();
        let first = self.in_file().0.max(rows.saturating_sub(capacity as u64));
        for row in first..rows {
            let numbers: Vec<f64> = self
                .row(row)
                .iter()
                .map(|word| f64::from_bits(word.load(Relaxed)))
                .collect();
            each(numbers[0], &numbers[1..]);
        }
    }

    /// Writes text after the rows in the file.
    pub(super) fn append(&self, file: &Path, text: &str) -> io::Result<()> {
        let mut file = OpenOptions::new().write(true).open(file)?;
        if file.metadata()?.is_file() {
            file.set_len(self.in_file().1)?;
            file.seek(SeekFrom::End(0))?;
        }
        file.write_all(text.as_bytes())?;
        if file.metadata()?.is_file() {
            file.sync_all()?;
        }
        Ok(())
    }
}
