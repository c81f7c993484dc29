//! `cargo fmu merge`: merges FMUs of one model that were built on different machines.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use fmu_file::merge::merge;
use fmu_master::is_fmu;

use super::export::print_fmu;
use super::files;
use crate::ui;

/// What to merge.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// Two or more FMUs, from any vendor
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// The FMU to write; may be one of the inputs
    #[arg(short, long, value_name = "FILE", value_parser = fmu)]
    out: PathBuf,
}

/// The file of an FMU.
pub(super) fn fmu(file: &str) -> Result<PathBuf, &'static str> {
    let file = PathBuf::from(file);
    is_fmu(&file).then_some(file).ok_or("expected a name that ends in .fmu")
}

/// Merges the FMUs and prints what was written.
///
/// # Errors
/// No file matches a pattern; see [`merge`].
pub fn run(args: &MergeArgs, out: &mut impl Write) -> Result<()> {
    let merged = merge(&files::expanded(&args.files)?, &args.out)?;
    for note in &merged.notes {
        ui::message(format_args!("note: {note}"));
    }
    print_fmu(&args.out, merged.size, &merged.platforms.join(" "), out)
}
