//! `cargo fmu ssp`: exports systems as SSP packages for other tools.

use std::fs;
use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use fmu_file::replace;
use fmu_master::Description;
use fmu_master::ssp::Package;

use super::files;
use crate::ui;

/// The systems to package, and the output folder.
#[derive(Debug, Args)]
pub struct SspArgs {
    /// System files
    #[arg(value_name = "SYSTEM.toml", required = true)]
    systems: Vec<PathBuf>,
    /// Output folder for the packages
    #[arg(long, value_name = "DIR", default_value = "target/fmu", value_parser = replace::folder)]
    out: PathBuf,
    /// Folder of the FMUs [default: as in the system file]
    #[arg(long, value_name = "DIR")]
    fmus: Option<PathBuf>,
}

/// Writes the packages, after all systems have been checked.
///
/// # Errors
/// No file matches a pattern, a system is invalid, as `simulate` reports it, or the folder is not writable.
pub fn run(args: &SspArgs, out: &mut impl Write) -> Result<()> {
    let systems = files::expanded(&args.systems)?;
    fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    replace::check_writable(&args.out)?;
    let mut packages: Vec<Package> = Vec::new();
    for system in &systems {
        let mut description = Description::read(system)?;
        if let Some(folder) = &args.fmus {
            description.take_fmus_from(folder);
        }
        let package = Package::new(system, &description, &args.out)?;
        ensure!(
            packages.iter().all(|other| other.file != package.file),
            "two of the systems would be written to {}",
            package.file.display()
        );
        packages.push(package);
    }
    for package in &packages {
        let size = package.write()?;
        let file = package.file.display();
        writeln!(out, "{file}  {} KB", size.div_ceil(1000))?;
        for warning in &package.warnings {
            ui::warn(&format!("{file} {warning}"));
        }
    }
    Ok(())
}
