//! `cargo fmu export`: builds models into FMUs.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use clap::{Args, ValueEnum};
use fmu_build::{Compression, FmiVersion, Options, Progress, Selection, Variant, Written};
use fmu_file::platform::Prebuilt;
use indicatif::{ProgressBar, ProgressStyle};

/// What to export, and for which platforms.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Models to export [default: all]
    #[arg(value_name = "MODEL")]
    models: Vec<String>,
    /// Name of a variant of the model, with other start values
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Start value of a variable in a variant; may be repeated
    #[arg(long = "set", value_name = "VARIABLE=VALUE", value_parser = setting)]
    settings: Vec<(String, String)>,
    /// Version of FMI; may be repeated. Files for FMI 3.0 are named MODEL_fmi3.fmu
    #[arg(long, value_name = "VERSION", value_delimiter = ',', default_value = "2.0")]
    fmi: Vec<Version>,
    /// Leave out variables of types that FMI 2.0 lacks, instead of refusing the model
    #[arg(long)]
    omit_unsupported: bool,
    /// Output folder for the FMUs [default: fmu in cargo's target folder]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Build for any Linux with glibc 2.17 or newer, using cargo-zigbuild
    #[arg(long)]
    portable: bool,
    /// Rust target to build for; may be repeated [default: this machine]. universal2-apple-darwin
    /// builds for both macOS architectures, x86_64-unknown-linux-gnu.2.28 for Linux with glibc 2.28, wasm
    /// (with --fmi 3.0) a WebAssembly component
    #[arg(long = "target", value_name = "TRIPLE")]
    targets: Vec<String>,
    /// Add a shared library built elsewhere, for linux64, win64, ...
    #[arg(long = "binary", value_name = "PLATFORM=FILE")]
    binaries: Vec<Prebuilt>,
    /// Compress with zopfli: 3.5 % smaller, but slow
    #[arg(long)]
    small: bool,
    #[command(flatten)]
    selection: SelectionArgs,
}

/// A version of FMI.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Version {
    #[value(name = "2.0")]
    Fmi2,
    #[value(name = "3.0")]
    Fmi3,
}

impl From<Version> for FmiVersion {
    fn from(version: Version) -> Self {
        match version {
            Version::Fmi2 => Self::Fmi2,
            Version::Fmi3 => Self::Fmi3,
        }
    }
}

/// Which packages to build, and how.
#[derive(Debug, Args)]
#[command(next_help_heading = "Options of cargo")]
pub struct SelectionArgs {
    /// Manifest of the package or workspace [default: the one in the current folder]
    #[arg(long, value_name = "PATH")]
    manifest_path: Option<PathBuf>,
    /// Package with the models; may be repeated [default: as cargo build, else all with models]
    #[arg(short, long = "package", value_name = "NAME")]
    packages: Vec<String>,
    /// Features of the package
    #[arg(short = 'F', long, value_name = "FEATURES", value_delimiter = ',')]
    features: Vec<String>,
    /// Activate all features
    #[arg(long)]
    all_features: bool,
    /// Do not activate the default features
    #[arg(long)]
    no_default_features: bool,
    /// Profile to build with
    #[arg(long, value_name = "NAME", default_value = "release")]
    profile: String,
}

impl From<SelectionArgs> for Selection {
    fn from(args: SelectionArgs) -> Self {
        Self {
            manifest_path: args.manifest_path,
            packages: args.packages,
            features: args.features,
            all_features: args.all_features,
            no_default_features: args.no_default_features,
            profile: args.profile,
        }
    }
}

fn setting(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((variable, value)) if !variable.is_empty() => {
            Ok((variable.to_owned(), value.to_owned()))
        }
        _ => Err("expected VARIABLE=VALUE".into()),
    }
}

/// Exports the models and prints the FMUs that were written.
///
/// # Errors
/// See [`fmu_build::export`].
pub fn run(args: ExportArgs, out: &mut impl Write) -> Result<()> {
    let options = Options {
        selection: args.selection.into(),
        models: args.models,
        variant: Variant { name: args.name, settings: args.settings },
        versions: args.fmi.into_iter().map(Into::into).collect(),
        omit_unsupported: args.omit_unsupported,
        out: args.out,
        portable: args.portable,
        targets: args.targets,
        binaries: args.binaries,
        compression: match args.small {
            true => Compression::Zopfli,
            false => Compression::Deflate,
        },
    };
    for fmu in build(&options)? {
        print_fmu(&fmu.file, fmu.size, &fmu.platforms.join(" "), out)?;
    }
    Ok(())
}

/// Exports models and shows the progress.
///
/// # Errors
/// See [`fmu_build::export`].
pub fn build(options: &Options) -> Result<Vec<Written>> {
    let spinner = ProgressBar::new_spinner();
    spinner.set_style(ProgressStyle::with_template("{spinner} {msg} {elapsed}")?);
    spinner.enable_steady_tick(Duration::from_millis(100));
    let print = |text: &str| spinner.suspend(|| eprintln!("{text}"));
    let written = fmu_build::export(options, &|progress| match progress {
        // Without a terminal, there is no spinner.
        Progress::Building(text) if spinner.is_hidden() => print(&format!("{text} ...")),
        Progress::Building(text) | Progress::Built(text) => spinner.set_message(text.to_owned()),
        Progress::Said(text) => print(text),
    });
    spinner.finish_and_clear();
    written
}

/// Prints an FMU that was written, its size and its platforms.
pub fn print_fmu(file: &Path, size: u64, platforms: &str, out: &mut impl Write) -> Result<()> {
    let here = std::env::current_dir().ok();
    let relative = here.and_then(|here| file.strip_prefix(here).ok());
    let file = relative.unwrap_or(file).display();
    writeln!(out, "{file}  {} KB  {platforms}", size.div_ceil(1000))?;
    Ok(())
}
