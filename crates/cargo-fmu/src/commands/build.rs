//! `cargo fmu build`: compiles the C and C++ sources of FMUs for this machine.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use fmu_compile::{CompileControl, CompileError, Compiled, binaries, compile, write_with};
use fmu_file::archive::Archive;
use fmu_file::platform;
use fmu_file::text::about;
use indicatif::{ProgressBar, ProgressStyle};

use super::export::print_fmu;
use super::files;
use super::merge::fmu;
use crate::session::{self, Session};
use crate::ui;

/// What to compile.
#[derive(Debug, Args)]
pub struct BuildArgs {
    /// The FMUs with their sources, from any vendor
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// The FMU to write, if there is one FMU to compile [default: the FMU itself]
    #[arg(short, long, value_name = "FILE", value_parser = fmu)]
    out: Option<PathBuf>,
    /// Replace binaries for this machine that the FMU has already
    #[arg(long)]
    force: bool,
    /// Print the commands of the compiler, and its warnings
    #[arg(short, long)]
    verbose: bool,
}

/// Compiles the FMUs and prints what was written.
///
/// # Errors
/// No file matches a pattern, or an FMU cannot be compiled.
pub fn run(args: &BuildArgs, out: &mut impl Write) -> Result<ExitCode> {
    let session = Session::start()?;
    let files = files::expanded(&args.files)?;
    let count = files.len();
    ensure!(args.out.is_none() || count == 1, "got {count} FMUs, expected one with --out");
    for file in &files {
        let target = args.out.as_ref().unwrap_or(file);
        match add_binary(file, target, args, &session, out) {
            Err(CompileError::Cancelled) => {
                ui::message(format_args!("interrupted; {} was not written", target.display()));
                return Ok(session.signal().map_or(ExitCode::FAILURE, session::code));
            }
            added => added.map_err(|error| error_about(file, error))?,
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes an FMU with the binary that is compiled from its sources.
fn add_binary(
    file: &Path,
    target: &Path,
    args: &BuildArgs,
    session: &Session,
    out: &mut impl Write,
) -> Result<(), CompileError> {
    let present = binaries(file)?;
    let is_kept = args.out.as_ref().is_none_or(|out| out == file) && !args.force;
    if let (Some(present), true) = (present.first(), is_kept) {
        let error = anyhow::anyhow!(
            "it has {present} already; --force replaces it, and --out writes another FMU"
        );
        return Err(error.into());
    }
    let folder = tempfile::tempdir_in(session.folder()).map_err(anyhow::Error::from)?;
    let compiled = compile_in(folder.path(), file, args.verbose, session)?;
    if args.verbose {
        // What it prints was cleaned when it was read.
        ui::message(format_args!("{}", compiled.log.trim_end()));
    }
    let size = write_with(file, &compiled.libraries, target)?;
    let archive = Archive::open_sound(target)?;
    let platforms = Vec::from_iter(platform::folders(&archive.names));
    Ok(print_fmu(target, size, &platforms.join(" "), out)?)
}

/// Compiles an FMU to a folder, and tells what was left out.
///
/// # Errors
/// As [`compile`].
pub fn compile_in(
    folder: &Path,
    file: &Path,
    warns: bool,
    session: &Session,
) -> Result<Compiled, CompileError> {
    let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}");
    let spinner = ProgressBar::new_spinner().with_style(style.map_err(anyhow::Error::from)?);
    spinner.set_message(format!("compiling {}", file.display()));
    spinner.enable_steady_tick(Duration::from_millis(100));
    let control = CompileControl {
        warns,
        is_cancelled: &|| session.signal().is_some(),
        ..CompileControl::default()
    };
    let compiled = compile(file, folder, &control);
    spinner.finish_and_clear();
    for note in compiled.iter().flat_map(|compiled| &compiled.notes) {
        ui::message(format_args!("note: {}: {note}", file.display()));
    }
    compiled
}

/// An error about an FMU. What a compiler prints keeps its lines.
pub fn error_about(file: &Path, error: CompileError) -> anyhow::Error {
    match error {
        CompileError::Failed { .. } | CompileError::MissingCompiler { .. } => {
            anyhow::anyhow!("{}: {error}", file.display())
        }
        error => about(file, &error.into()),
    }
}
