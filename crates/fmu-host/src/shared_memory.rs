//! Memory that several processes share.

use std::fmt::Debug;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use memmap2::MmapOptions;

/// A file mapped to memory. What one process writes is visible to the others, and survives it. Clones
/// share the memory.
#[derive(Debug, Clone)]
pub struct SharedMemory {
    /// The words that the owner keeps, to save an indirection.
    words: NonNull<[AtomicU64]>,
    _owner: Arc<dyn Debug + Send + Sync>,
}

/// The number of words that are accessed without looking whether they exist.
const FIRST: usize = 2;

// SAFETY: the words are atomic, and their owner may be dropped by any thread.
unsafe impl Send for SharedMemory {}
// SAFETY: as above.
unsafe impl Sync for SharedMemory {}

impl SharedMemory {
    /// Creates a file with this number of words, all zero. The space on disk is allocated at once, as
    /// writing to a mapped file on a full disk would end the process.
    ///
    /// # Errors
    /// The file exists, or cannot be written or mapped.
    pub fn create(path: &Path, words: usize) -> io::Result<Self> {
        let mut file = OpenOptions::new().read(true).write(true).create_new(true).open(path)?;
        file.write_all(&vec![0; words * size_of::<AtomicU64>()])?;
        Self::map(&file, words)
    }

    /// Ordinary memory of this process.
    pub fn private(words: usize) -> Self {
        let own: Vec<_> = (0..words.max(FIRST)).map(|_| AtomicU64::new(0)).collect();
        Self { words: NonNull::from(own.as_slice()), _owner: Arc::new(own) }
    }

    /// Maps a file that another process has created.
    ///
    /// # Errors
    /// The file cannot be read, written or mapped.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        let words = file.metadata()?.len() as usize / size_of::<AtomicU64>();
        Self::map(&file, words)
    }

    fn map(file: &File, words: usize) -> io::Result<Self> {
        let length = words * size_of::<AtomicU64>();
        let map = MmapOptions::new().len(length).map_raw(file)?;
        let first = NonNull::new(map.as_mut_ptr().cast::<AtomicU64>());
        let first = first.filter(|_| words >= FIRST);
        let first = first.ok_or_else(|| io::Error::other("it has too few words"))?;
        Ok(Self { words: NonNull::slice_from_raw_parts(first, words), _owner: Arc::new(map) })
    }

    /// The words from one on, as memory of its own; `None` if there are too few.
    pub fn tail(&self, first: usize) -> Option<Self> {
        let words = self.words().get(first..).filter(|words| words.len() >= FIRST)?;
        Some(Self { words: NonNull::from(words), _owner: self._owner.clone() })
    }

    /// The words.
    #[inline]
    pub fn words(&self) -> &[AtomicU64] {
        // SAFETY: the owner lives as long as `self` and gives no other access. A map is writable,
        // aligned to a page and at least this long; all processes write atomic words, and every value
        // is a valid word.
        unsafe { self.words.as_ref() }
    }

    /// The first words, which always exist.
    #[inline]
    pub fn first(&self) -> &[AtomicU64; FIRST] {
        // SAFETY: as above; all constructors make at least so many words.
        unsafe { self.words.cast().as_ref() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::Ordering::Relaxed;

    #[test]
    fn what_one_writes_the_other_reads() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("memory");
        let ours = SharedMemory::create(&file, 100).unwrap();
        let theirs = SharedMemory::open(&file).unwrap();
        assert_eq!(theirs.words().len(), 100);
        assert_eq!(theirs.words()[99].load(Relaxed), 0);
        ours.words()[99].store(7, Relaxed);
        assert_eq!(theirs.words()[99].load(Relaxed), 7);
        assert!(SharedMemory::create(&file, 1).is_err());
    }
}
