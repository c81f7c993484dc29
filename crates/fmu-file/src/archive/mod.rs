//! FMU files: zip archives that are written reproducibly and read as untrusted input.

mod packed;
mod read;

use std::io::Cursor;
use std::path::Path;

use anyhow::{Context, Result, bail};
use zip::ZipWriter;

use crate::replace;

pub use packed::{Compression, Packed};
pub use read::{Archive, MODEL_DESCRIPTION, relative};

/// Path of the documentation page in an FMU.
pub const DOCUMENTATION: &str = "documentation/index.html";
/// Path of the icon in an FMU.
pub const ICON: &str = "model.png";

/// A file in an archive.
pub struct Entry<'a> {
    /// Its path in the archive.
    pub path: String,
    /// Its content.
    pub file: &'a Packed,
}

impl<'a> Entry<'a> {
    /// Creates an entry for a file.
    pub fn new(path: impl Into<String>, file: &'a Packed) -> Self {
        Self {
            path: path.into(),
            file,
        }
    }
}

/// Writes an archive atomically and returns its size in bytes.
///
/// # Errors
/// The archive cannot be written.
pub fn write(file: &Path, entries: &[Entry<'_>]) -> Result<u64> {
    let bytes = zip(entries).with_context(|| format!("cannot pack {}", file.display()))?;
    replace::write(file, &bytes)?;
    Ok(bytes.len() as u64)
}

/// Builds an archive from the entries, in order.
fn zip(entries: &[Entry<'_>]) -> Result<Vec<u8>> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for Entry { path, file } in entries {
        match read::relative(path) {
            Ok(clean) if clean == *path => {}
            Ok(clean) => bail!("the file name is {path:?}, expected {clean:?}"),
            Err(fault) => bail!(fault),
        }
        file.copy(path, &mut writer)?;
    }
    Ok(writer.finish()?.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files() -> [Packed; 2] {
        let (text, program) = (
            Packed::text(b"<a/>"),
            Packed::program(b"\x7fELF", Compression::Deflate),
        );
        [text.unwrap(), program.unwrap()]
    }

    fn entries([text, program]: &[Packed; 2]) -> [Entry<'_>; 2] {
        [
            Entry::new("modelDescription.xml", text),
            Entry::new("binaries/linux64/A.so", program),
        ]
    }

    #[test]
    fn archives_round_trip_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("A.fmu");
        let size = write(&file, &entries(&files())).unwrap();
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
        assert_eq!(
            zip(&entries(&files())).unwrap(),
            zip(&entries(&files())).unwrap()
        );
    }

    #[test]
    fn file_modes_are_kept() {
        let bytes = zip(&entries(&files())).unwrap();
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
        let mut mode = |index| archive.by_index(index).unwrap().unix_mode();
        assert_eq!(mode(0), Some(0o100_644));
        assert_eq!(mode(1), Some(0o100_755));
    }

    #[test]
    fn invalid_names_are_rejected() {
        let [text, _] = files();
        let error = zip(&[Entry::new("../a", &text)]).unwrap_err();
        assert!(error.to_string().contains("\"../a\""), "{error}");
    }

    #[test]
    fn nothing_is_left_behind_when_writing_fails() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("A.fmu");
        std::fs::create_dir(&taken).unwrap();
        assert!(write(&taken, &entries(&files())).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn damaged_archives_never_panic() {
        let sound = zip(&entries(&files())).unwrap();
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
            // Any result but a panic.
            let _ = Archive::open_sound(&file).and_then(|mut a| a.model_description());
        }
    }
}
