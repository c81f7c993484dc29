//! `cargo fmu pack`: makes one FMU of a system.

use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Args;
use fmu_build::{BuildProgress, ContainerTargets, container_page};
use fmu_description::xml::Element;
use fmu_description::{ExportedModel, FmiVersion, ModelDescription};
use fmu_file::archive::{self, DOCUMENTATION, MODEL_DESCRIPTION, Packed};
use fmu_file::platform::Prebuilt;
use fmu_file::replace;
use fmu_master::container::Contents;
use fmu_master::{Description, is_fmu, locate};

use super::export::{print_fmu, with_progress};
use super::files::stem;
use super::merge::fmu;
use crate::ui;

mod about;

/// The system, and the FMU that is made of it.
#[derive(Debug, Args)]
pub struct PackArgs {
    /// System file or SSP package
    #[arg(value_name = "SYSTEM")]
    system: PathBuf,
    #[command(flatten)]
    options: PackOptions,
}

/// The FMU that is made of a system.
#[derive(Debug, Args)]
pub struct PackOptions {
    /// The FMU to write [default: the name of the system, in this folder]
    #[arg(short, long, value_name = "FILE", value_parser = fmu)]
    pub out: Option<PathBuf>,
    /// Version of FMI
    #[arg(long = "fmi", value_name = "VERSION", default_value = "2.0", value_parser = fmu_build::version())]
    pub version: FmiVersion,
    /// Folder of the FMUs [default: as in the system file]
    #[arg(long, value_name = "DIR")]
    pub fmus: Option<PathBuf>,
    /// Rust target to build the master for; may be repeated. All FMUs of the system need a binary for it [default:
    /// this machine]
    #[arg(long = "target", value_name = "TRIPLE")]
    pub targets: Vec<String>,
    /// Add a library of the crate fmu-container that was built elsewhere, for linux64, win64, ...
    #[arg(long = "binary", value_name = "PLATFORM=FILE")]
    pub binaries: Vec<Prebuilt>,
}

/// A container that was written.
#[derive(Debug)]
pub struct PackedSystem {
    /// Its path.
    pub file: PathBuf,
    /// Its size in bytes.
    pub size: u64,
    /// The platform folders that it has binaries in.
    pub platforms: Vec<&'static str>,
    /// What is missing, and what hosts cannot do.
    pub notes: Vec<String>,
}

/// Packs the system and prints the FMU that was written.
///
/// # Errors
/// See [`pack`].
pub fn run(args: PackArgs, out: &mut impl Write) -> Result<()> {
    let packed = with_progress(|progress| pack(&args.system, None, &args.options, progress))?;
    for note in &packed.notes {
        ui::message(format_args!("note: {note}"));
    }
    print_fmu(&packed.file, packed.size, &packed.platforms.join(" "), out)
}

/// Writes the container of a system; `text` is the text of the system file, if it is not on the disk.
///
/// # Errors
/// The system is invalid, as `simulate` reports it, or cannot be packed; a build fails; the file cannot be written.
pub fn pack(
    system: &Path,
    text: Option<&str>,
    options: &PackOptions,
    progress: &dyn Fn(BuildProgress<'_>),
) -> Result<PackedSystem> {
    ensure!(
        !is_fmu(system),
        "{} is an FMU, expected a system file or an SSP package",
        system.display()
    );
    let mut description = match text {
        Some(text) => Description::parse_unsaved(text, system)?,
        None => Description::read(system)?,
    };
    if let Some(folder) = &options.fmus {
        description.take_fmus_from(folder);
    }
    let (is_package, is_saved) = (description.package.is_some(), text.is_none());
    let text = match text {
        Some(text) => text.to_owned(),
        None if is_package => description.to_toml()?,
        None => fs::read_to_string(system)?,
    };
    let packed = pack_description(&description, &text, system, options, progress);
    packed.map_err(|error| match is_saved && !is_package {
        true => locate(error, system, &text),
        false => error,
    })
}

fn pack_description(
    description: &Description,
    text: &str,
    system: &Path,
    options: &PackOptions,
    progress: &dyn Fn(BuildProgress<'_>),
) -> Result<PackedSystem> {
    let PackOptions { version, targets, binaries, .. } = options;
    let targets = ContainerTargets { targets: targets.clone(), binaries: binaries.clone() };
    let file = options.out.clone().unwrap_or_else(|| format!("{}.fmu", stem(system)).into());
    let version = *version;
    let name = identifier(&stem(&file));
    let contents = Contents::new(description, text, &name, version)?;
    let binaries =
        targets.binaries(version, |platform| contents.check_platform(platform), progress)?;
    let root = model_description(&contents.model, version)?;
    let file_name = file.file_name().unwrap_or_default().to_string_lossy();
    let page = container_page(
        &ModelDescription::new(&root),
        &file_name,
        &about::html(description, &contents),
    );
    let mut entries = vec![
        (MODEL_DESCRIPTION.to_owned(), Packed::text(root.document()?.as_bytes())?),
        (DOCUMENTATION.to_owned(), Packed::text(page.as_bytes())?),
    ];
    let mut platforms = BTreeSet::new();
    for binary in &binaries {
        for platform in &binary.platforms {
            platforms.insert(platform.folder);
            entries.push((platform.binary(&name), Packed::program(&binary.bytes)?));
        }
    }
    for (path, content) in &contents.resources {
        let packed = match path.contains("/binaries/") {
            true => Packed::program(content)?,
            false => Packed::text(content)?,
        };
        entries.push((format!("resources/{path}"), packed));
    }
    let entries = Vec::from_iter(entries.iter().map(|(path, packed)| (path.as_str(), packed)));
    let bytes = archive::zip(&entries);
    let bytes = bytes.with_context(|| format!("{} cannot be packed", file.display()))?;
    replace::write(&file, &bytes)?;
    Ok(PackedSystem {
        file,
        size: bytes.len() as u64,
        platforms: Vec::from_iter(platforms),
        notes: contents.notes,
    })
}

fn model_description(model: &ExportedModel, version: FmiVersion) -> Result<Element<'static>> {
    let generation_tool = concat!("cargo-fmu ", env!("CARGO_PKG_VERSION")).to_owned();
    let origin = fmu_description::Origin { generation_tool, ..Default::default() };
    model.to_xml(version, &origin)
}

/// A name as an identifier of C.
fn identifier(name: &str) -> String {
    let letters = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    let name: String = letters.collect();
    match name.starts_with(|c: char| c.is_ascii_digit()) || name.is_empty() {
        true => format!("_{name}"),
        false => name,
    }
}
