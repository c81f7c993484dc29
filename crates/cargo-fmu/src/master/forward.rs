//! Hands a command on to this program built with the feature `master`.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::Path;
use std::process::{Command, ExitCode};

use anyhow::{Context, Result, ensure};

use crate::build::Build;

/// Builds the program with the master, unless that is done, and lets it do the command.
///
/// # Errors
/// It was not started by cargo in its own workspace, or cannot be built.
pub fn forward(arguments: impl Iterator<Item = OsString>) -> Result<ExitCode> {
    let package = std::env::var_os("CARGO_MANIFEST_DIR").context(
        "this cargo-fmu was built without the master; `cargo install --path crates/cargo-fmu --features master` builds one with it",
    )?;
    let manifest = Path::new(&package).join("Cargo.toml");
    if let Some(libclang) = std::env::var_os("LIBCLANG_PATH") {
        let folder = Path::new(&libclang);
        ensure!(
            folder.exists(),
            "the master needs libclang at {}; `make libclang` puts it there",
            folder.display()
        );
    }
    let mut build = Build::new("building the master", "build");
    build
        .args(["--locked", "--profile", "native", "--features", "master"])
        .args([OsStr::new("--manifest-path"), manifest.as_os_str()]);
    let artifacts = build.run(packages(&manifest))?;
    let program = artifacts
        .executable("cargo-fmu")
        .context("cargo built no program cargo-fmu")?;
    let status = Command::new(program)
        .args(arguments)
        .status()
        .with_context(|| format!("cannot run {}", program.display()))?;
    Ok(match status.code() {
        Some(code) => ExitCode::from(u8::try_from(code).unwrap_or(1)),
        None => ExitCode::FAILURE,
    })
}

/// How many packages there are to build, for the progress bar.
fn packages(manifest: &Path) -> usize {
    let lock = manifest
        .ancestors()
        .map(|folder| folder.join("Cargo.lock"))
        .find(|file| file.is_file());
    let text = lock.and_then(|file| fs::read_to_string(file).ok());
    text.unwrap_or_default().matches("[[package]]").count()
}
