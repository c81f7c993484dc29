//! `cargo fmu run`: builds models as fast as possible and simulates them, again after each change.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;
use std::thread;
use std::time::{Duration, SystemTime};

use anyhow::{Result, bail};
use clap::Args;
use fmu_build::{ExportOptions, FmiVersion, Selection};

use super::export;
use super::simulate::{self, SimulateArgs};
use crate::session::{self, Session};
use crate::ui;

/// The model to try out, and how.
#[derive(Debug, Args)]
pub struct RunArgs {
    #[command(flatten)]
    simulation: SimulateArgs,
    /// Run again after each change of a source file of the workspace
    #[arg(long)]
    watch: bool,
    #[command(flatten)]
    selection: Selection,
}

/// Interval between looks at the sources.
const PERIOD: Duration = Duration::from_millis(300);

/// Builds the models to a temporary folder and simulates them; with `--watch`, until a signal.
///
/// # Errors
/// The models cannot be built, or as [`simulate::run`]; with `--watch`, such errors are only printed.
pub fn run(mut args: RunArgs, out: &mut impl Write) -> Result<ExitCode> {
    let session = Session::start()?;
    let folder = session.folder().join("fmu");
    let models = Vec::from_iter(args.simulation.model());
    if let Some(path) = models.iter().find(|model| model.contains(['/', '\\'])) {
        bail!(
            "{path}: expected the name of a model, or a system file (.toml); `--manifest-path` names another workspace"
        );
    }
    args.simulation.use_fmus(&folder);
    let options = ExportOptions {
        selection: args.selection,
        models,
        versions: vec![FmiVersion::Fmi2],
        out: Some(folder.clone()),
        is_for_trial: true,
        ..ExportOptions::default()
    };
    let metadata = options.selection.metadata()?;
    let (root, target) = (metadata.workspace_root.as_std_path(), metadata.target_directory);
    loop {
        let begin = SystemTime::now();
        let ended = export::build(&options).and_then(|_| match session.signal() {
            Some(signal) => Ok(session::code(signal)),
            None => simulate::supervise(&args.simulation, &session, out),
        });
        if !args.watch {
            return ended;
        }
        if let Some(signal) = session.signal() {
            return Ok(session::code(signal));
        }
        if let Err(error) = ended {
            ui::error(&error);
        }
        args.simulation.page.open = false;
        let waiting = format!("waiting for a change in {}\n", root.display());
        match args.simulation.prints_rows() {
            true => ui::message(format_args!("{waiting}")),
            false => writeln!(out, "{waiting}")?,
        }
        while !has_changed(root, target.as_std_path(), begin) {
            thread::sleep(PERIOD);
            if let Some(signal) = session.signal() {
                return Ok(session::code(signal));
            }
        }
    }
}

/// Whether a manifest or a source file outside the target folder has changed since a time.
fn has_changed(folder: &Path, target: &Path, since: SystemTime) -> bool {
    // A folder may vanish meanwhile, or be that of another user.
    let mut entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.any(|entry| {
        let path = entry.path();
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            // Cargo marks the target folders that it creates by this file.
            let is_left_out = entry.file_name().to_string_lossy().starts_with('.')
                || path == target
                || path.join("CACHEDIR.TAG").exists();
            return !is_left_out && has_changed(&path, target, since);
        }
        let is_source =
            path.extension().is_some_and(|extension| extension == "rs" || extension == "toml");
        is_source && entry.metadata().and_then(|data| data.modified()).is_ok_and(|at| at > since)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_sources_outside_the_target_folder_are_watched() {
        let root = tempfile::tempdir().unwrap();
        let [target, source] = ["target", "src"].map(|name| root.path().join(name));
        fs::create_dir_all(&target).unwrap();
        fs::write(target.join("built.rs"), "").unwrap();
        let has_changed = || has_changed(root.path(), &target, SystemTime::UNIX_EPOCH);
        assert!(!has_changed());
        fs::create_dir(&source).unwrap();
        fs::write(source.join("lib.rs"), "").unwrap();
        assert!(has_changed());
        fs::remove_dir_all(&root).unwrap();
        assert!(!has_changed());
    }
}
