//! FMU files: zip archives, written the same for the same content, and read with care.

mod read;

use std::io::{Cursor, Write};
use std::path::Path;

use anyhow::{Context, Result};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use crate::replace::Replacement;

pub use read::{Archive, MODEL_DESCRIPTION};

/// A file in an archive.
pub struct Entry<'a> {
    path: String,
    content: &'a [u8],
    mode: u32,
}

impl<'a> Entry<'a> {
    /// A file to be read.
    pub fn text(path: impl Into<String>, content: &'a [u8]) -> Self {
        Self {
            path: path.into(),
            content,
            mode: 0o644,
        }
    }

    /// A file to be loaded or run.
    pub fn program(path: impl Into<String>, content: &'a [u8]) -> Self {
        Self {
            path: path.into(),
            content,
            mode: 0o755,
        }
    }
}

/// Writes an archive, whole or not at all, and returns its size in bytes.
///
/// # Errors
/// It cannot be written.
pub fn write(file: &Path, entries: &[Entry<'_>]) -> Result<u64> {
    let bytes = zip(entries).with_context(|| format!("cannot pack {}", file.display()))?;
    let mut new = Replacement::of(file)?;
    new.write_all(&bytes)
        .with_context(|| format!("cannot write {}", file.display()))?;
    new.finish()?;
    Ok(bytes.len() as u64)
}

/// Packs the entries in their order. Time stamps are those of an empty clock, so the same entries
/// give the same bytes.
fn zip(entries: &[Entry<'_>]) -> Result<Vec<u8>> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for entry in entries {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(9))
            .last_modified_time(DateTime::default())
            .unix_permissions(entry.mode);
        writer.start_file(entry.path.as_str(), options)?;
        writer.write_all(entry.content)?;
    }
    Ok(writer.finish()?.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries() -> [Entry<'static>; 2] {
        [
            Entry::text("modelDescription.xml", b"<a/>"),
            Entry::program("binaries/linux64/A.so", b"\x7fELF"),
        ]
    }

    #[test]
    fn what_is_written_is_read_back_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("A.fmu");
        let size = write(&file, &entries()).unwrap();
        let mut archive = Archive::open_sound(&file).unwrap();
        assert_eq!(archive.model_description().unwrap(), "<a/>");
        assert_eq!(
            archive.names,
            ["modelDescription.xml", "binaries/linux64/A.so"]
        );
        assert_eq!(archive.size, size);
    }

    #[test]
    fn the_same_content_gives_the_same_bytes() {
        assert_eq!(zip(&entries()).unwrap(), zip(&entries()).unwrap());
    }

    #[test]
    fn nothing_is_left_behind_when_writing_fails() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("A.fmu");
        std::fs::create_dir(&taken).unwrap();
        assert!(write(&taken, &entries()).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn every_damaged_archive_is_refused_or_read() {
        let sound = zip(&entries()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("A.fmu");
        for cut in 0..sound.len() {
            std::fs::write(&file, &sound[..cut]).unwrap();
            assert!(Archive::open(&file).is_err(), "cut at {cut}");
        }
        for position in 0..sound.len() {
            let mut damaged = sound.clone();
            damaged[position] ^= 0x55;
            std::fs::write(&file, &damaged).unwrap();
            // Any answer but a panic.
            let _ = Archive::open_sound(&file).and_then(|mut a| a.model_description());
        }
    }
}
