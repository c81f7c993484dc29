//! Reads untrusted FMUs: no file is written outside the target folder, and sizes are limited to protect
//! memory and disk.

use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fmu_description::xml;
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
    /// Names of all files and folders, corrected to relative paths with single forward slashes; empty for
    /// an entry of the FMU itself.
    pub names: Vec<String>,
    /// Size of the archive in bytes.
    pub size: u64,
    /// Reasons why it must not be unpacked.
    pub faults: Vec<String>,
    /// Faults that do no harm, such as names that had to be corrected.
    pub oddities: Vec<String>,
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
        let written = zip
            .file_names()
            .map(|name| name.map(|name| name.into_owned()))
            .collect::<Result<Vec<_>, _>>()
            .context("it is damaged: invalid file name")?;
        let size = metadata.len();
        let mut check = Check::default();
        check.names(&written, &zip);
        check.entries(&mut zip, size);
        Ok(Self {
            zip,
            names: check.names,
            size,
            faults: check.faults,
            oddities: check.oddities,
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

    /// Reads the model description as text; what is not UTF-8 is decoded all the same.
    ///
    /// # Errors
    /// It is missing, damaged or too large.
    pub fn model_description(&mut self) -> Result<String> {
        Ok(xml::decode(&self.model_description_bytes()?).text)
    }

    /// Reads the model description.
    ///
    /// # Errors
    /// As [`Archive::model_description`].
    pub fn model_description_bytes(&mut self) -> Result<Vec<u8>> {
        let index = self.index_of(MODEL_DESCRIPTION).with_context(|| {
            format!("it is not an FMU: it has no {MODEL_DESCRIPTION} at its root")
        })?;
        self.read(index, MAX_XML)
    }

    /// The index of a file; of several with the same name the last, as other tools do.
    fn index_of(&self, name: &str) -> Option<usize> {
        self.names.iter().rposition(|other| other == name)
    }

    /// Reads the first bytes of a file.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn head(&mut self, name: &str, length: u64) -> Result<Vec<u8>> {
        let index = self.index_of(name).context("there is no such file")?;
        let file = self.zip.by_index(index)?;
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
            if !name.starts_with(prefix) || name.is_empty() || name.ends_with('/') {
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

/// What is wrong with an archive.
#[derive(Default)]
struct Check {
    names: Vec<String>,
    faults: Vec<String>,
    oddities: Vec<String>,
}

impl Check {
    fn names(&mut self, written: &[String], zip: &ZipArchive<BufReader<File>>) {
        for name in written {
            match relative(name) {
                Ok(clean) => {
                    if clean != *name {
                        let expected = match clean.as_str() {
                            "" => "none for the FMU itself".to_owned(),
                            clean => quote(clean),
                        };
                        let name = quote(name);
                        self.oddities
                            .push(format!("the file name is {name}, expected {expected}"));
                    }
                    self.names.push(clean);
                }
                Err(fault) => {
                    self.faults.push(fault);
                    self.names.push(name.clone());
                }
            }
        }
        let mut folded: Vec<(String, &str)> = self
            .names
            .iter()
            .map(|name| (name.to_lowercase(), name.as_str()))
            .collect();
        folded.sort_unstable();
        let twins = folded.windows(2).find(|pair| pair[0].0 == pair[1].0);
        if zip.has_duplicate_names() {
            self.oddities
                .push("two files have the same name, expected each name once".into());
        } else if let Some([(_, first), (_, second)]) = twins {
            let (first, second) = (quote(first), quote(second));
            self.oddities.push(format!(
                "the file names {first} and {second} are the same but for upper and lower case, which some systems ignore"
            ));
        }
    }

    fn entries(&mut self, zip: &mut ZipArchive<BufReader<File>>, size: u64) {
        if !zip.has_duplicate_names()
            && let Err(error) = zip.validate_header_consistency()
        {
            self.oddities
                .push(format!("its directory is wrong: {error}"));
        }
        let mut inflated = 0_u64;
        for (index, name) in self.names.iter().enumerate() {
            match entry(zip, index) {
                Ok(Entry { size, is_link }) => {
                    inflated = inflated.saturating_add(size);
                    if is_link {
                        self.oddities.push(format!(
                            "{} is a symbolic link, expected a file",
                            quote(name)
                        ));
                    }
                }
                Err(fault) => self.faults.push(format!("{} {fault}", quote(name))),
            }
        }
        if inflated > MAX_INFLATED {
            self.faults.push(format!(
                "it inflates to {} MB, expected at most {} MB: a zip bomb?",
                inflated >> 20,
                MAX_INFLATED >> 20
            ));
        } else if inflated > RATIO_FROM && inflated / MAX_RATIO > size {
            self.faults.push(format!(
                "it inflates to {} times its size, expected at most {MAX_RATIO} times: a zip bomb?",
                inflated / size.max(1)
            ));
        }
    }
}

/// The name of a file as a path inside the target folder on every system: relative, with single forward
/// slashes, without `.`; a folder ends with a slash.
///
/// # Errors
/// The path may lead outside, or the name is empty or has control characters.
pub fn relative(name: &str) -> Result<String, String> {
    let path = name.replace('\\', "/");
    let first = path.split('/').next().unwrap_or_default();
    let what = if path.starts_with('/') || first.contains(':') {
        "is an absolute path, expected a relative path"
    } else if path.split('/').any(|part| part == "..") {
        "leaves its folder (path traversal), expected a path without .."
    } else if name.is_empty() || name.chars().any(char::is_control) {
        "is empty or has a control character"
    } else {
        let parts: Vec<&str> = path.split('/').collect();
        let is_folder = matches!(parts.last(), Some(&("" | ".")));
        let kept = parts.into_iter().filter(|part| !matches!(*part, "" | "."));
        let mut clean = kept.collect::<Vec<_>>().join("/");
        if is_folder && !clean.is_empty() {
            clean.push('/');
        }
        return Ok(clean);
    };
    Err(format!("the file name {} {what}", quote(name)))
}

struct Entry {
    size: u64,
    is_link: bool,
}

/// The inflated size of a file, and whether it is a link, or why it cannot be used.
fn entry(zip: &mut ZipArchive<BufReader<File>>, index: usize) -> Result<Entry, String> {
    let options = ZipReadOptions::new().ignore_encryption_flag(true);
    let file = match zip.by_index_with_options(index, options) {
        Ok(file) => file,
        Err(error) => return Err(format!("cannot be read: {error}")),
    };
    if file.encrypted() {
        return Err("is encrypted, expected no encryption".into());
    }
    match file.compression() {
        CompressionMethod::Stored | CompressionMethod::Deflated => Ok(Entry {
            size: file.size(),
            is_link: file.is_symlink(),
        }),
        other => Err(format!(
            "is compressed with {other}, expected deflate or none"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_corrected_or_rejected() {
        for bad in [
            "../a",
            "a/../../b",
            "a\\..\\..\\b",
            "/etc/passwd",
            "\\a",
            "C:/a",
            "c:a",
            "C:\\a",
            "",
            "a\0",
            "a\nb",
        ] {
            assert!(relative(bad).is_err(), "{bad:?}");
        }
        for good in ["a", "binaries/linux64/a.so", "a..b/..c", "folder/", "ä/ö ü"] {
            assert_eq!(relative(good).unwrap(), good);
        }
        for (odd, expected) in [
            ("./", ""),
            ("./a", "a"),
            ("a/./b", "a/b"),
            ("a//b", "a/b"),
            ("a\\b", "a/b"),
            ("a/.", "a/"),
            ("./a//", "a/"),
        ] {
            assert_eq!(relative(odd).unwrap(), expected);
        }
    }
}
