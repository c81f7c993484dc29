//! Compressed files, from which archives are put together.

use std::io::{Cursor, Read, Write};

use anyhow::Result;
use zip::read::ZipFile;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

/// Levels above 9 are those of zopfli, which takes so many rounds more to find the shortest form.
/// Binaries get 3.5 % smaller than with 9; rounds after the third take time and gain nothing.
const LEVEL: i64 = 9;

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
        Self::new(content, 0o644, CompressionMethod::Deflated)
    }

    /// A file that is compressed already, as an FMU in a package of several.
    ///
    /// # Errors
    /// It is too large for an archive.
    pub fn stored(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o644, CompressionMethod::Stored)
    }

    /// A file to be loaded or run.
    ///
    /// # Errors
    /// It cannot be compressed.
    pub fn program(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o755, CompressionMethod::Deflated)
    }

    /// Its time stamp is that of an empty clock, so the same content gives the same bytes.
    fn new(content: &[u8], mode: u32, method: CompressionMethod) -> Result<Self> {
        let level = (method == CompressionMethod::Deflated).then_some(LEVEL);
        let options = SimpleFileOptions::default()
            .compression_method(method)
            .compression_level(level)
            .last_modified_time(DateTime::default())
            .unix_permissions(mode);
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        writer.start_file("file", options)?;
        writer.write_all(content)?;
        Ok(Self(writer.finish()?.into_inner()))
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
