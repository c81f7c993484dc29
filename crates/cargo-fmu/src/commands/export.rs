//! `cargo fmu export`: builds models into FMUs.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use fmu_build::Compression;
use fmu_file::platform::Prebuilt;

/// What to export, and for which platforms.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Models to export [default: all]
    #[arg(value_name = "MODEL")]
    models: Vec<String>,
    /// Output folder for the FMUs [default: fmu in cargo's target folder]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Build for any Linux with glibc 2.17 or newer, using cargo-zigbuild
    #[arg(long)]
    portable: bool,
    /// Rust target to build for; may be repeated [default: this machine]. universal2-apple-darwin
    /// builds for both macOS architectures, x86_64-unknown-linux-gnu.2.28 for Linux with glibc 2.28
    #[arg(long = "target", value_name = "TRIPLE")]
    targets: Vec<String>,
    /// Add a shared library built elsewhere, for linux64, win64, ...
    #[arg(long = "binary", value_name = "PLATFORM=FILE")]
    binaries: Vec<Prebuilt>,
    /// Compress with zopfli: 3.5 % smaller, but slow
    #[arg(long)]
    small: bool,
}

/// Exports the models and prints the FMUs that were written.
///
/// # Errors
/// See [`fmu_build::export`].
pub fn run(args: ExportArgs, out: &mut impl Write) -> Result<()> {
    let written = fmu_build::export(&fmu_build::Options {
        models: args.models,
        out: args.out,
        portable: args.portable,
        targets: args.targets,
        binaries: args.binaries,
        compression: match args.small {
            true => Compression::Zopfli,
            false => Compression::Deflate,
        },
    })?;
    for fmu in written {
        print_fmu(&fmu.file, fmu.size, &fmu.platforms.join(" "), out)?;
    }
    Ok(())
}

/// Prints an FMU that was written, its size and its platforms.
pub fn print_fmu(file: &Path, size: u64, platforms: &str, out: &mut impl Write) -> Result<()> {
    let here = std::env::current_dir().ok();
    let relative = here.and_then(|here| file.strip_prefix(here).ok());
    let file = relative.unwrap_or(file).display();
    writeln!(out, "{file}  {} KB  {platforms}", size.div_ceil(1000))?;
    Ok(())
}
