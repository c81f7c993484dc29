//! Reads untrusted FMUs: no file is written outside the target folder, and sizes are limited to protect
//! memory and disk.

use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use zip::{CompressionMethod, ZipArchive, ZipReadOptions};

use super::packed::Packed;
use crate::text::quote;

/// Maximum size of a model description; a larger one is damaged or malicious.
const MAX_XML: u64 = 64 << 20;
/// Maximum number of files.
const MAX_FILES: usize = 1 << 16;
/// Maximum total size of the inflated files.
const MAX_INFLATED: u64 = 1 << 30;
/// Maximum ratio of the total inflated size to the size of the archive, checked above [`RATIO_FROM`].
/// Typical ratios are 3 for binaries and 20 for tables.
const MAX_RATIO: u64 = 200;
const RATIO_FROM: u64 = 16 << 20;

/// The name of the model description in every FMU.
pub const MODEL_DESCRIPTION: &str = "modelDescription.xml";

/// An open FMU archive.
pub struct Archive {
    zip: ZipArchive<BufReader<File>>,
    /// Names of all files and folders.
    pub names: Vec<String>,
    /// Size of the archive in bytes.
    pub size: u64,
    /// Reasons why it must not be unpacked.
    pub faults: Vec<String>,
}

impl Archive {
    /// Reads the directory of an archive.
    ///
    /// # Errors
    /// The file cannot be read or is not an archive.
    pub fn open(file: &Path) -> Result<Self> {
        let metadata = fs::metadata(file).context("cannot open it")?;
        ensure!(
            metadata.is_file(),
            "it is a folder or device, expected a file"
        );
        let open = File::open(file).context("cannot open it")?;
        let mut zip =
            ZipArchive::new(BufReader::new(open)).context("it is damaged, or not an FMU")?;
        ensure!(
            zip.len() <= MAX_FILES,
            "it contains {} files, expected at most {MAX_FILES}",
            zip.len()
        );
        let names = zip
            .file_names()
            .map(|name| name.map(|name| name.into_owned()))
            .collect::<Result<Vec<_>, _>>()
            .context("it is damaged: invalid file name")?;
        let size = metadata.len();
        let faults = faults(&mut zip, &names, size);
        Ok(Self {
            zip,
            names,
            size,
            faults,
        })
    }

    /// Like [`Archive::open`], but rejects archives with faults.
    ///
    /// # Errors
    /// As [`Archive::open`], or the first fault.
    pub fn open_sound(file: &Path) -> Result<Self> {
        let archive = Self::open(file)?;
        match archive.faults.first() {
            Some(fault) => bail!("{fault}"),
            None => Ok(archive),
        }
    }

    /// Reads the model description.
    ///
    /// # Errors
    /// It is missing, damaged, too large, or not UTF-8.
    pub fn model_description(&mut self) -> Result<String> {
        let index = self
            .zip
            .index_for_name(MODEL_DESCRIPTION)
            .with_context(|| {
                format!("it is not an FMU: it has no {MODEL_DESCRIPTION} at its root")
            })?;
        let bytes = self.read(index, MAX_XML)?;
        String::from_utf8(bytes).map_err(|error| {
            let at = error.utf8_error().valid_up_to();
            anyhow::anyhow!("{MODEL_DESCRIPTION} is not UTF-8 from byte {at} on")
        })
    }

    /// Reads the first bytes of a file.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn head(&mut self, name: &str, length: u64) -> Result<Vec<u8>> {
        let file = self.zip.by_name(name)?;
        let mut bytes = Vec::new();
        file.take(length).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    fn read(&mut self, index: usize, max_size: u64) -> Result<Vec<u8>> {
        let name = &self.names[index];
        let file = self
            .zip
            .by_index(index)
            .with_context(|| format!("{name} cannot be read"))?;
        let mut bytes = Vec::new();
        file.take(max_size + 1)
            .read_to_end(&mut bytes)
            .with_context(|| format!("{name} is damaged"))?;
        ensure!(
            bytes.len() as u64 <= max_size,
            "{name} is larger than {} MB",
            max_size >> 20
        );
        Ok(bytes)
    }

    /// Inflates a file.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn content(&mut self, index: usize) -> Result<Vec<u8>> {
        let mut content = Vec::new();
        self.copy(index, &mut content)
            .with_context(|| format!("{} is damaged", quote(&self.names[index])))?;
        Ok(content)
    }

    /// Copies a file in compressed form, for another archive.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn packed(&mut self, index: usize) -> Result<Packed> {
        Packed::of(self.zip.by_index_raw(index)?)
            .with_context(|| format!("{} cannot be copied", quote(&self.names[index])))
    }

    /// Inflates every file and describes the damaged ones.
    pub fn damages(&mut self) -> Vec<String> {
        (0..self.names.len())
            .filter_map(|index| {
                let error = self.copy(index, &mut io::sink()).err()?;
                Some(format!(
                    "{} is damaged: {error:#}",
                    quote(&self.names[index])
                ))
            })
            .collect()
    }

    /// Unpacks the files whose names start with `prefix` to a folder.
    ///
    /// # Errors
    /// The archive has faults, or a file cannot be read or written.
    pub fn unpack(&mut self, prefix: &str, folder: &Path) -> Result<()> {
        ensure!(self.faults.is_empty(), "it is not safe to unpack");
        for index in 0..self.names.len() {
            let name = self.names[index].clone();
            if !name.starts_with(prefix) || name.ends_with('/') {
                continue;
            }
            let file = folder.join(&name);
            if let Some(parent) = file.parent() {
                fs::create_dir_all(parent)?;
            }
            self.copy(index, &mut File::create(&file)?)
                .with_context(|| format!("cannot unpack {}", quote(&name)))?;
        }
        Ok(())
    }

    /// Inflates a file; fails if its size is not as declared.
    fn copy(&mut self, index: usize, to: &mut impl io::Write) -> Result<()> {
        let file = self.zip.by_index(index)?;
        let size = file.size();
        let copied = io::copy(&mut file.take(size.saturating_add(1)), to)?;
        ensure!(
            copied == size,
            "it inflates to {}, expected {size} bytes",
            if copied > size {
                "more".into()
            } else {
                copied.to_string()
            }
        );
        Ok(())
    }
}

/// Reasons why an archive must not be unpacked.
fn faults(zip: &mut ZipArchive<BufReader<File>>, names: &[String], size: u64) -> Vec<String> {
    let mut faults: Vec<String> = names.iter().filter_map(|name| bad_name(name)).collect();
    let mut folded: Vec<String> = names.iter().map(|name| name.to_lowercase()).collect();
    folded.sort_unstable();
    let duplicate = folded.windows(2).find(|pair| pair[0] == pair[1]);
    if zip.has_duplicate_names() {
        faults.push("two files have the same name".into());
    } else if let Some([name, _]) = duplicate {
        faults.push(format!(
            "two files have the name {} and differ only in upper and lower case, which some systems ignore",
            quote(name)
        ));
    } else if let Err(error) = zip.validate_header_consistency() {
        faults.push(format!("its directory is wrong: {error}"));
    }
    let mut inflated = 0_u64;
    for (index, name) in names.iter().enumerate() {
        match bad_entry(zip, index) {
            Ok(length) => inflated = inflated.saturating_add(length),
            Err(fault) => faults.push(format!("{} {fault}", quote(name))),
        }
    }
    if inflated > MAX_INFLATED {
        faults.push(format!(
            "it inflates to {} MB, expected at most {} MB: a zip bomb?",
            inflated >> 20,
            MAX_INFLATED >> 20
        ));
    } else if inflated > RATIO_FROM && inflated / MAX_RATIO > size {
        faults.push(format!(
            "it inflates to {} times its size, expected at most {MAX_RATIO} times: a zip bomb?",
            inflated / size.max(1)
        ));
    }
    faults
}

/// What is wrong with a file name: on every system, the file must stay inside the target folder.
pub(super) fn bad_name(name: &str) -> Option<String> {
    let first = name.split('/').next().unwrap_or_default();
    let what = if name.contains('\\') {
        "has a backslash, expected forward slashes"
    } else if name.starts_with('/') || first.contains(':') {
        "is an absolute path, expected a relative path"
    } else if name.split('/').any(|part| part == ".." || part == ".") {
        "leaves its folder (path traversal), expected a path without . and .."
    } else if name.is_empty() || name.contains("//") || name.chars().any(char::is_control) {
        "is empty or has an empty part or a control character"
    } else {
        return None;
    };
    Some(format!("the file name {} {what}", quote(name)))
}

/// The inflated size of a file, or why it cannot be used.
fn bad_entry(zip: &mut ZipArchive<BufReader<File>>, index: usize) -> Result<u64, String> {
    let options = ZipReadOptions::new().ignore_encryption_flag(true);
    let file = match zip.by_index_with_options(index, options) {
        Ok(file) => file,
        Err(error) => return Err(format!("cannot be read: {error}")),
    };
    if file.encrypted() {
        return Err("is encrypted, expected no encryption".into());
    }
    if file.is_symlink() {
        return Err("is a symbolic link, expected a file".into());
    }
    match file.compression() {
        CompressionMethod::Stored | CompressionMethod::Deflated => Ok(file.size()),
        other => Err(format!(
            "is compressed with {other}, expected deflate or none"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsafe_names_are_rejected() {
        for bad in [
            "../a",
            "a/../../b",
            "/etc/passwd",
            "C:/a",
            "c:a",
            "a\\b",
            "",
            "a//b",
            "./a",
            "a/.",
            "a\0",
            "a\nb",
        ] {
            assert!(bad_name(bad).is_some(), "{bad:?}");
        }
        for good in ["a", "binaries/linux64/a.so", "a..b/..c", "folder/", "ä/ö ü"] {
            assert_eq!(bad_name(good), None);
        }
    }
}
