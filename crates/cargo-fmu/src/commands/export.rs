//! `cargo fmu export`: builds models into FMUs.

use std::cell::Cell;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Result;
use fmu_build::{BuildProgress, ExportOptions, ExportedFmu};
use indicatif::{ProgressBar, ProgressStyle};

use crate::ui;

/// How often a build without a terminal says what it has built. The standard library from its sources takes minutes.
const PERIOD: Duration = Duration::from_secs(10);

/// Exports the models and prints the FMUs that were written.
///
/// # Errors
/// See [`fmu_build::export`].
pub fn run(options: &ExportOptions, out: &mut impl Write) -> Result<()> {
    for fmu in build(options)? {
        print_fmu(&fmu.file, fmu.size, &fmu.platforms.join(" "), out)?;
    }
    Ok(())
}

/// Exports models and shows the progress.
///
/// # Errors
/// See [`fmu_build::export`].
pub fn build(options: &ExportOptions) -> Result<Vec<ExportedFmu>> {
    with_progress(|progress| fmu_build::export(options, progress))
}

/// Shows the progress of a build.
///
/// # Errors
/// The build fails.
pub(super) fn with_progress<T>(
    build: impl FnOnce(&dyn Fn(BuildProgress<'_>)) -> Result<T>,
) -> Result<T> {
    let spinner = ProgressBar::new_spinner();
    spinner.set_style(ProgressStyle::with_template("{spinner} {msg} {elapsed}")?);
    spinner.enable_steady_tick(Duration::from_millis(100));
    let print = |text: &str| spinner.suspend(|| ui::message(format_args!("{text}")));
    let said = Cell::new(Instant::now());
    let built = build(&|progress| match progress {
        // Without a terminal, there is no spinner.
        BuildProgress::Building(text) if spinner.is_hidden() => {
            said.set(Instant::now());
            print(&format!("{text} ..."));
        }
        BuildProgress::Built(text) if spinner.is_hidden() => {
            if said.get().elapsed() >= PERIOD {
                said.set(Instant::now());
                print(text);
            }
        }
        BuildProgress::Building(text) | BuildProgress::Built(text) => {
            spinner.set_message(text.to_owned())
        }
        BuildProgress::Said(text) => print(text),
    });
    spinner.finish_and_clear();
    built
}

/// Prints an FMU that was written, its size and its platforms.
pub fn print_fmu(file: &Path, size: u64, platforms: &str, out: &mut impl Write) -> Result<()> {
    let here = std::env::current_dir().ok();
    let relative = here.and_then(|here| file.strip_prefix(here).ok());
    let file = relative.unwrap_or(file).display();
    writeln!(out, "{file}  {} KB  {platforms}", size.div_ceil(1000))?;
    Ok(())
}
