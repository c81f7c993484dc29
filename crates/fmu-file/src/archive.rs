//! FMU files: zip archives that are written reproducibly and read as untrusted input. No file is written
//! outside the target folder, and sizes are limited to protect memory and disk.

use std::fs::{self, File};
use std::io::{self, BufReader, Cursor, Read, Write};
use std::path::Path;

use anyhow::{Context, Error, Result, bail, ensure};
use fmu_description::xml;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipReadOptions, ZipWriter};

use crate::replace;
use crate::text::quote;

/// The name of the model description in every FMU.
pub const MODEL_DESCRIPTION: &str = "modelDescription.xml";
/// Path of the documentation page in an FMU.
pub const DOCUMENTATION: &str = "documentation/index.html";
/// Path of the icon in an FMU of FMI 2.0.
pub const ICON: &str = "model.png";
/// Path of the icon in an FMU of FMI 3.0.
pub const ICON_3: &str = "terminalsAndIcons/icon.png";
/// Path of the terminals in an FMU of FMI 3.0.
pub const TERMINALS: &str = "terminalsAndIcons/terminalsAndIcons.xml";
/// Path of the manifest of FMI-LS-BUS.
pub const BUS_MANIFEST: &str = "extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml";

/// Maximum size of a model description; a larger one is damaged or malicious.
const MAX_XML: u64 = 64 << 20;
/// Maximum size of a file of SSP, which has the variables of several FMUs.
pub const MAX_SSP: u64 = 256 << 20;
/// Maximum number of files.
const MAX_FILES: usize = 1 << 16;
/// Maximum total size of the inflated files.
const MAX_INFLATED: u64 = 1 << 30;
/// Maximum ratio of the total inflated size to the size of the archive, checked above [`RATIO_FROM`].
/// Typical ratios are 3 for binaries and 20 for tables.
const MAX_RATIO: u64 = 200;
const RATIO_FROM: u64 = 16 << 20;

// --- writing --------------------------------------------------------------------------------------

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
        Self::new(content, 0o644, true)
    }

    /// Stores a file that is already compressed, such as an FMU in a package of several.
    ///
    /// # Errors
    /// The file is too large for an archive.
    pub fn stored(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o644, false)
    }

    /// Compresses an executable or a shared library.
    ///
    /// # Errors
    /// The file cannot be compressed.
    pub fn program(content: &[u8]) -> Result<Self> {
        Self::new(content, 0o755, true)
    }

    /// The time stamp is constant, so that the same content gives the same bytes.
    fn new(content: &[u8], mode: u32, is_compressed: bool) -> Result<Self> {
        let (method, level) = match is_compressed {
            true => (CompressionMethod::Deflated, Some(9)),
            false => (CompressionMethod::Stored, None),
        };
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
}

/// Writes an archive atomically and returns its size in bytes; see [`zip()`].
///
/// # Errors
/// The archive cannot be written.
pub fn write(file: &Path, entries: &[(impl AsRef<str>, &Packed)]) -> Result<u64> {
    let bytes = zip(entries).with_context(|| format!("cannot pack {}", file.display()))?;
    replace::write(file, &bytes)?;
    Ok(bytes.len() as u64)
}

/// Returns the archive of files with their paths, in order.
///
/// # Errors
/// A path is not relative, or the archive is too large.
pub fn zip(entries: &[(impl AsRef<str>, &Packed)]) -> Result<Vec<u8>> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (path, Packed(bytes)) in entries {
        let path = path.as_ref();
        let clean = relative(path).map_err(Error::msg)?;
        ensure!(clean == path, "the file name is {path:?}, expected {clean:?}");
        let mut packed = ZipArchive::new(Cursor::new(bytes))?;
        writer.raw_copy_file_rename(packed.by_index(0)?, path)?;
    }
    Ok(writer.finish()?.into_inner())
}

// --- reading --------------------------------------------------------------------------------------

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
    /// Names that begin with `./`, which some tools write.
    pub dotted: Vec<String>,
}

impl Archive {
    /// Reads the directory of an archive.
    ///
    /// # Errors
    /// The file cannot be read or is not an archive.
    pub fn open(file: &Path) -> Result<Self> {
        ensure!(
            file != Path::new("-"),
            "it is the standard input, in which an archive cannot be searched; expected a file, such as ./-"
        );
        let metadata = fs::metadata(file).context("cannot open it")?;
        ensure!(metadata.is_file(), "it is a folder or device, expected a file");
        let open = File::open(file).context("cannot open it")?;
        let zip = ZipArchive::new(BufReader::new(open)).context("it is damaged, or not an FMU")?;
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
        let mut archive = Self {
            zip,
            names: Vec::new(),
            size: metadata.len(),
            faults: Vec::new(),
            oddities: Vec::new(),
            dotted: Vec::new(),
        };
        archive.check_names(written);
        archive.check_entries();
        Ok(archive)
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

    /// Corrects names, and notes those that are odd or lead outside.
    fn check_names(&mut self, written: Vec<String>) {
        for name in written {
            let clean = relative(&name).unwrap_or_else(|fault| {
                self.faults.push(fault);
                name.clone()
            });
            if clean != name {
                let expected = match clean.as_str() {
                    "" => "none for the FMU itself".to_owned(),
                    clean => quote(clean),
                };
                let oddity = format!("the file name is {}, expected {expected}", quote(&name));
                match name.strip_prefix("./") == Some(&clean) {
                    true => self.dotted.push(oddity),
                    false => self.oddities.push(oddity),
                }
            }
            self.names.push(clean);
        }
        let folded = self.names.iter().map(|name| (name.to_lowercase(), name));
        let mut folded: Vec<_> = folded.collect();
        folded.sort_unstable();
        let twins = folded.windows(2).find(|pair| pair[0].0 == pair[1].0);
        if self.zip.has_duplicate_names() {
            self.oddities.push("two files have the same name, expected each name once".into());
        } else if let Some([(_, first), (_, second)]) = twins {
            let (first, second) = (quote(first), quote(second));
            self.oddities.push(format!(
                "the file names {first} and {second} are the same but for upper and lower case, which some systems ignore"
            ));
        }
    }

    /// Notes entries that cannot be read, and inflated sizes that would exhaust memory or disk.
    fn check_entries(&mut self) {
        if !self.zip.has_duplicate_names()
            && let Err(error) = self.zip.validate_header_consistency()
        {
            self.oddities.push(format!("its directory is wrong: {error}"));
        }
        let mut inflated = 0_u64;
        for (index, name) in self.names.iter().enumerate() {
            match entry(&mut self.zip, index) {
                Ok((size, is_link)) => {
                    inflated = inflated.saturating_add(size);
                    if is_link {
                        let oddity = format!("{} is a symbolic link, expected a file", quote(name));
                        self.oddities.push(oddity);
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
        } else if inflated > RATIO_FROM && inflated / MAX_RATIO > self.size {
            self.faults.push(format!(
                "it inflates to {} times its size, expected at most {MAX_RATIO} times: a zip bomb?",
                inflated / self.size.max(1)
            ));
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
        let file = self.zip.by_index(index);
        let file = file.with_context(|| format!("{MODEL_DESCRIPTION} cannot be read"))?;
        bounded(file, MODEL_DESCRIPTION, MAX_XML)
    }

    /// Reads an XML file as text; `None` if there is none. What is not UTF-8 is decoded all the same.
    ///
    /// # Errors
    /// It is damaged or too large.
    pub fn text(&mut self, name: &str) -> Result<Option<String>> {
        let Some(index) = self.index_of(name) else { return Ok(None) };
        let file = self.zip.by_index(index);
        let file = file.with_context(|| format!("{name} cannot be read"))?;
        Ok(Some(xml::decode(&bounded(file, name, MAX_XML)?).text))
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
        let mut bytes = Vec::new();
        let file = self.zip.by_index(index)?;
        file.take(length).read_to_end(&mut bytes)?;
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
        let mut copy = || {
            let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
            writer.raw_copy_file_rename(self.zip.by_index_raw(index)?, "file")?;
            anyhow::Ok(Packed(writer.finish()?.into_inner()))
        };
        copy().with_context(|| format!("{} cannot be copied", quote(&self.names[index])))
    }

    /// Inflates every file and describes the damaged ones.
    pub fn damages(&mut self) -> Vec<String> {
        let mut damages = Vec::new();
        for index in 0..self.names.len() {
            if let Err(error) = self.copy(index, &mut io::sink()) {
                damages.push(format!("{} is damaged: {error:#}", quote(&self.names[index])));
            }
        }
        damages
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
    fn copy(&mut self, index: usize, to: &mut impl Write) -> Result<()> {
        let file = self.zip.by_index(index)?;
        let size = file.size();
        let copied = io::copy(&mut file.take(size.saturating_add(1)), to)?;
        ensure!(copied <= size, "it inflates to more, expected {size} bytes");
        ensure!(copied == size, "it inflates to {copied}, expected {size} bytes");
        Ok(())
    }
}

/// Reads a file of SSP as text; what is not UTF-8 is decoded all the same.
///
/// # Errors
/// It cannot be read, or is too large.
pub fn read_ssp(file: &Path) -> Result<String> {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let open = File::open(file).with_context(|| format!("{name} cannot be read"))?;
    Ok(xml::decode(&bounded(open, &name, MAX_SSP)?).text)
}

fn bounded(file: impl Read, name: &str, most: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = file.take(most + 1).read_to_end(&mut bytes);
    read.with_context(|| format!("{name} is damaged"))?;
    ensure!(bytes.len() as u64 <= most, "{name} is larger than {} MB", most >> 20);
    Ok(bytes)
}

/// The name of a file as a path inside the target folder on every system: relative, with single forward
/// slashes, without `.`; a folder ends with a slash.
///
/// # Errors
/// The path may lead outside, or the name is empty or has control characters.
pub fn relative(name: &str) -> Result<String, String> {
    let path = name.replace('\\', "/");
    let parts: Vec<&str> = path.split('/').collect();
    let what = if path.starts_with('/') || parts[0].contains(':') {
        "is an absolute path, expected a relative path"
    } else if parts.contains(&"..") {
        "leaves its folder (path traversal), expected a path without .."
    } else if name.is_empty() || name.chars().any(char::is_control) {
        "is empty or has a control character"
    } else {
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

/// The inflated size of a file, and whether it is a link, or why it cannot be used.
fn entry(zip: &mut ZipArchive<BufReader<File>>, index: usize) -> Result<(u64, bool), String> {
    let options = ZipReadOptions::new().ignore_encryption_flag(true);
    let file = zip.by_index_with_options(index, options);
    let file = file.map_err(|error| format!("cannot be read: {error}"))?;
    if file.encrypted() {
        return Err("is encrypted, expected no encryption".into());
    }
    match file.compression() {
        CompressionMethod::Stored | CompressionMethod::Deflated => {
            Ok((file.size(), file.is_symlink()))
        }
        other => Err(format!("is compressed with {other}, expected deflate or none")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes of an archive of a model description and a library.
    fn sound() -> Vec<u8> {
        let text = Packed::text(b"<a/>").unwrap();
        let program = Packed::program(b"\x7fELF").unwrap();
        zip(&[(MODEL_DESCRIPTION, &text), ("binaries/linux64/A.so", &program)]).unwrap()
    }

    #[test]
    fn archives_keep_order_contents_and_modes() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("A.fmu");
        fs::write(&file, sound()).unwrap();
        let mut archive = Archive::open_sound(&file).unwrap();
        assert_eq!(archive.names, [MODEL_DESCRIPTION, "binaries/linux64/A.so"]);
        assert_eq!(archive.size, sound().len() as u64);
        assert_eq!(archive.model_description().unwrap(), "<a/>");
        assert_eq!(archive.content(1).unwrap(), b"\x7fELF");
        let mut mode = |index| archive.zip.by_index(index).unwrap().unix_mode();
        assert_eq!([mode(0), mode(1)], [Some(0o100_644), Some(0o100_755)]);
    }

    #[test]
    fn cut_archives_are_rejected() {
        let sound = sound();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("A.fmu");
        for cut in 0..sound.len() {
            fs::write(&file, &sound[..cut]).unwrap();
            assert!(Archive::open(&file).is_err(), "cut at {cut}");
        }
    }

    #[test]
    fn names_are_corrected_or_rejected() {
        let outside = "../a a/../../b a\\..\\..\\b /etc/passwd \\a C:/a c:a C:\\a a\0 a\nb";
        for bad in outside.split(' ').chain([""]) {
            assert!(relative(bad).is_err(), "{bad:?}");
        }
        let text = Packed::text(b"").unwrap();
        let error = zip(&[("../a", &text)]).unwrap_err().to_string();
        assert!(error.contains("\"../a\""), "{error}");
        for (name, expected) in [
            ("binaries/linux64/a.so", "binaries/linux64/a.so"),
            ("a..b/..c", "a..b/..c"),
            ("folder/", "folder/"),
            ("ä/ö ü", "ä/ö ü"),
            ("./", ""),
            ("./a", "a"),
            ("a/./b", "a/b"),
            ("a//b", "a/b"),
            ("a\\b", "a/b"),
            ("a/.", "a/"),
            ("./a//", "a/"),
        ] {
            assert_eq!(relative(name).unwrap(), expected);
        }
    }
}
