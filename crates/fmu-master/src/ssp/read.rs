//! Reads packages (.ssp) and system structures (.ssd) as descriptions of systems.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Error, Result, bail, ensure};
use fmu_description::xml::{self, Element};
use fmu_file::archive::{self, Archive};
use fmu_host::Owned;
use tempfile::TempDir;

use super::system::FlatSystem;
use super::vocabulary::{self, EXPERIMENT, OMS_INFORMATION, OMS_MASTER, OSP_FIXED_STEP};
use crate::fmu::{Units, units};
use crate::{Description, Order};

/// The system structure of a package.
pub const STRUCTURE_FILE: &str = "SystemStructure.ssd";

/// Where a system comes from if not from a TOML file.
#[derive(Debug)]
pub struct SystemOrigin {
    /// What was left out, such as parameters without a variable.
    pub warnings: Vec<String>,
    /// The files outside of packages that it refers to.
    pub(crate) files: Vec<PathBuf>,
    /// The packages and structures, until the FMUs are loaded.
    opened: Vec<OpenedPackage>,
}

impl SystemOrigin {
    /// A text with the names of packages in place of the folders to which they are unpacked.
    pub(crate) fn named(&self, error: &Error) -> Error {
        named(&self.opened, error)
    }
}

fn named(opened: &[OpenedPackage], error: &Error) -> Error {
    let unpacked = opened.iter().rev().filter(|files| files.is_package());
    Error::msg(unpacked.fold(format!("{error:#}"), |text, files| {
        let [folder, file] = [&files.folder, &files.file].map(|path| path.display().to_string());
        text.replace(&folder, &file)
    }))
}

/// Whether a file is a package or a system structure, by its name.
pub(crate) fn is_package(file: &Path) -> bool {
    has_extension(file, "ssp") || has_extension(file, "ssd")
}

fn has_extension(file: &Path, expected: &str) -> bool {
    file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(expected))
}

/// Reads a package or a system structure. The components step in parallel, as in most tools. SSP has no step:
/// it is taken from the annotations for libcosim and OMSimulator, or is the smallest step of the FMUs, or
/// divides the time into 500 steps.
///
/// # Errors
/// The file cannot be read, is invalid, or has a part that is not supported.
pub fn read(file: &Path) -> Result<Description> {
    let read = || {
        let mut opened = vec![OpenedPackage::open(file)?];
        let mut description = describe(&mut opened).map_err(|error| named(&opened, &error))?;
        if let Some(source) = description.package.as_mut().and_then(Arc::get_mut) {
            source.opened = opened;
        }
        anyhow::Ok(description)
    };
    read().with_context(|| file.display().to_string())
}

/// The units that a structure defines.
pub fn units_of(structure: &Element<'_>) -> Units {
    units(structure.list(vocabulary::UNITS, vocabulary::UNIT), vocabulary::BASE_UNIT)
}

/// The outermost system of a structure.
pub fn system_of<'a>(structure: &'a Element<'a>) -> Result<&'a Element<'a>> {
    structure.child(vocabulary::SYSTEM).context("it has no system")
}

fn describe(opened: &mut Vec<OpenedPackage>) -> Result<Description> {
    let text = opened[0].structure()?;
    let root = document(&text, vocabulary::STRUCTURE)?;
    let mut system = FlatSystem::new(opened, units_of(&root));
    system.add(system_of(&root)?, "")?;
    let connections = system.connections()?;
    let experiment = root.child(EXPERIMENT);
    let time =
        |name, default| match experiment.and_then(|e| Some((e.attribute(name)?, e.real(name)))) {
            None => Ok(default),
            Some((text, time)) => {
                time.with_context(|| format!("{name} is {text:?}, expected a time in s"))
            }
        };
    let start = time("startTime", 0.0)?;
    let stop = time("stopTime", start + 1.0)?;
    let of_fmus =
        || system.models.iter().flatten().filter_map(|m| m.experiment[2]).reduce(f64::min);
    let step = step(&root).or_else(of_fmus).unwrap_or((stop - start) / 500.0);
    system.warnings.extend(system.undefined.take());
    let mut seen = HashSet::new();
    system.warnings.retain(|warning| seen.insert(warning.clone()));
    Ok(Description {
        start,
        stop,
        step,
        order: Order::Parallel,
        components: system.components,
        connections,
        package: Some(Arc::new(SystemOrigin {
            warnings: system.warnings,
            files: system.sources,
            opened: Vec::new(),
        })),
        ..Description::default()
    })
}

/// The communication step in the annotations of other tools.
fn step(element: &Element<'_>) -> Option<f64> {
    let own = match element.name {
        OSP_FIXED_STEP => element.real("baseStepSize"),
        OMS_INFORMATION => element.real("fixedStepSize"),
        OMS_MASTER => element.real("stepSize"),
        _ => None,
    };
    own.or_else(|| element.children.iter().find_map(step))
}

/// Maximum number of elements of a document; those of a package have the variables of all its FMUs.
const MAX_ELEMENTS: usize = 1 << 22;

/// Parses a document of SSP 1 with this root.
///
/// # Errors
/// It is another document.
pub fn document<'a>(text: &'a str, root: &str) -> Result<Element<'a>> {
    let mut element = xml::parse_up_to(MAX_ELEMENTS, text)?;
    let namespace = vocabulary::namespace(&element);
    vocabulary::normalize(&mut element)?;
    if element.name != root {
        let of = match namespace {
            _ if element.name.contains(':') => String::new(),
            Some(namespace) => format!(" of {namespace}"),
            None => " without a namespace".to_owned(),
        };
        bail!("the root is {}{of}, expected {root} of SSP 1.0", element.name);
    }
    let version = element.attribute("version").unwrap_or_default();
    ensure!(version.starts_with("1."), "version {version:?} of SSP is not supported, expected 1.0");
    Ok(element)
}

/// Checks that a structure can be read again.
///
/// # Errors
/// It is larger than the limits.
pub fn check(structure: &str) -> Result<()> {
    let most = archive::MAX_SSP;
    ensure!(structure.len() as u64 <= most, "{STRUCTURE_FILE} is larger than {} MB", most >> 20);
    document(structure, vocabulary::STRUCTURE).map(drop).context(STRUCTURE_FILE)
}

/// The files that a system structure refers to.
#[derive(Debug)]
pub struct OpenedPackage {
    /// The package or the structure.
    file: PathBuf,
    folder: PathBuf,
    /// The folder of a package, which files must not leave.
    unpacked: Option<Owned<TempDir>>,
}

impl OpenedPackage {
    /// Opens a structure (.ssd) or unpacks a package.
    ///
    /// # Errors
    /// It is not a package.
    pub fn open(file: &Path) -> Result<Self> {
        if has_extension(file, "ssd") {
            let folder = file.parent().unwrap_or(Path::new("")).to_owned();
            return Ok(Self { file: file.to_owned(), folder, unpacked: None });
        }
        let unpacked = tempfile::Builder::new().prefix("ssp-").tempdir()?;
        Archive::open_sound(file)?.unpack("", unpacked.path())?;
        let folder = unpacked.path().to_owned();
        ensure!(
            folder.join(STRUCTURE_FILE).exists(),
            "it is not an SSP package: it has no {STRUCTURE_FILE} at its root"
        );
        Ok(Self { file: file.to_owned(), folder, unpacked: Some(Owned::new(unpacked)) })
    }

    /// Whether its files are in a package.
    pub fn is_package(&self) -> bool {
        self.unpacked.is_some()
    }

    /// The text of the structure.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn structure(&self) -> Result<String> {
        match self.is_package() {
            true => archive::read_ssp(&self.folder.join(STRUCTURE_FILE)),
            false => archive::read_ssp(&self.file),
        }
    }

    /// The file at a URI.
    ///
    /// # Errors
    /// It is not a relative path, or leaves the package.
    pub fn path(&self, uri: &str) -> Result<PathBuf> {
        let is_relative =
            !uri.is_empty() && !uri.starts_with('/') && !uri.contains([':', '#', '?']);
        let Some(path) = decoded(uri).filter(|_| is_relative) else {
            bail!("the source {uri:?} is not supported, expected the relative path of a file");
        };
        if self.is_package() {
            archive::relative(&path).map_err(Error::msg)?;
        }
        Ok(self.folder.join(path))
    }
}

/// A URI without percent encoding.
fn decoded(uri: &str) -> Option<String> {
    let mut parts = uri.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    for part in parts {
        bytes.push(u8::from_str_radix(part.get(..2)?, 16).ok()?);
        bytes.extend(part[2..].bytes());
    }
    String::from_utf8(bytes).ok()
}
