//! Compressed files, from which archives are put together.

use std::io::{Cursor, Read, Write};

use anyhow::Result;
use zip::read::ZipFile;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

/// How hard to compress.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Compression {
    /// By deflate at its highest level.
    #[default]
    Deflate,
    /// By zopfli, a slow search for the shortest form: binaries get 3.5 % smaller.
    Zopfli,
}

impl Compression {
    /// As the crate `zip` takes it: a level above 9 is zopfli with so many rounds more. Rounds after
    /// the third take time and gain nothing.
    fn level(self) -> i64 {
        match self {
            Self::Deflate => 9,
            Self::Zopfli => 9 + 3,
        }
    }
}

/// A file, compressed once for all archives that it goes into.
///
/// It is an archive with this file alone: from there the crate `zip` copies without compressing anew.
pub struct Packed(Vec<u8>);

impl Packed {
    /// A file to be read.
    ///
    /// # Errors
    /// It cannot be compressed.
    pub fn text(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o644, Some(Compression::Deflate))
    }

    /// A file that is compressed already, as an FMU in a package of several.
    ///
    /// # Errors
    /// It is too large for an archive.
    pub fn stored(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o644, None)
    }

    /// A file to be loaded or run.
    ///
    /// # Errors
    /// It cannot be compressed.
    pub fn program(content: &[u8], compression: Compression) -> Result<Self> {
        Self::new(content, 0o755, Some(compression))
    }

    /// Its time stamp is that of an empty clock, so the same content gives the same bytes.
    fn new(content: &[u8], mode: u32, compression: Option<Compression>) -> Result<Self> {
        let method = match compression {
            Some(_) => CompressionMethod::Deflated,
            None => CompressionMethod::Stored,
        };
        let options = SimpleFileOptions::default()
            .compression_method(method)
            .compression_level(compression.map(Compression::level))
            .last_modified_time(DateTime::default())
            .unix_permissions(mode);
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        writer.start_file("file", options)?;
        writer.write_all(content)?;
        Ok(Self(writer.finish()?.into_inner()))
    }

    /// The bytes to keep for [`Packed::from_bytes`].
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// What was packed before, if it holds this content.
    pub fn from_bytes(packed: Vec<u8>, content: &[u8]) -> Option<Self> {
        let mut archive = ZipArchive::new(Cursor::new(packed.as_slice())).ok()?;
        let mut unpacked = Vec::new();
        let file = archive.by_name("file").ok()?;
        file.take(content.len() as u64 + 1)
            .read_to_end(&mut unpacked)
            .ok()?;
        drop(archive);
        (unpacked == content).then_some(Self(packed))
    }

    /// A file of another archive, as it is packed there.
    pub(super) fn of<R: Read>(file: ZipFile<'_, R>) -> Result<Self> {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        writer.raw_copy_file_rename(file, "file")?;
        Ok(Self(writer.finish()?.into_inner()))
    }

    /// Adds it to an archive.
    pub(super) fn copy(&self, path: &str, to: &mut ZipWriter<Cursor<Vec<u8>>>) -> Result<()> {
        let mut packed = ZipArchive::new(Cursor::new(self.0.as_slice()))?;
        to.raw_copy_file_rename(packed.by_index(0)?, path)?;
        Ok(())
    }
}
