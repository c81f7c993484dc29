//! Compressed files, from which archives are built.

use std::io::{Cursor, Read, Write};

use anyhow::Result;
use zip::read::ZipFile;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

/// Compression method.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Compression {
    /// Deflate at its highest level.
    #[default]
    Deflate,
    /// Zopfli, a slow search for the smallest deflate stream: binaries are 3.5 % smaller.
    Zopfli,
}

impl Compression {
    /// The level for the crate `zip`: 9 plus n means zopfli with n iterations. More than three
    /// iterations take time without gain.
    fn level(self) -> i64 {
        match self {
            Self::Deflate => 9,
            Self::Zopfli => 9 + 3,
        }
    }
}

/// A file that is compressed once for all archives that contain it.
///
/// It is stored as an archive of this file alone, from which the crate `zip` copies it without
/// compressing it again.
pub struct Packed(Vec<u8>);

impl Packed {
    /// Compresses an ordinary file.
    ///
    /// # Errors
    /// The file cannot be compressed.
    pub fn text(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o644, Some(Compression::Deflate))
    }

    /// Stores a file that is already compressed, such as an FMU in a package of several.
    ///
    /// # Errors
    /// The file is too large for an archive.
    pub fn stored(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o644, None)
    }

    /// Compresses an executable or a shared library.
    ///
    /// # Errors
    /// The file cannot be compressed.
    pub fn program(content: &[u8], compression: Compression) -> Result<Self> {
        Self::new(content, 0o755, Some(compression))
    }

    /// The time stamp is constant, so that the same content gives the same bytes.
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

    /// The bytes for [`Packed::from_bytes`].
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Restores a packed file, if it has the given content.
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

    /// Copies a compressed file from another archive.
    pub(super) fn of<R: Read>(file: ZipFile<'_, R>) -> Result<Self> {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        writer.raw_copy_file_rename(file, "file")?;
        Ok(Self(writer.finish()?.into_inner()))
    }

    /// Adds the file to an archive.
    pub(super) fn copy(&self, path: &str, to: &mut ZipWriter<Cursor<Vec<u8>>>) -> Result<()> {
        let mut packed = ZipArchive::new(Cursor::new(self.0.as_slice()))?;
        to.raw_copy_file_rename(packed.by_index(0)?, path)?;
        Ok(())
    }
}
