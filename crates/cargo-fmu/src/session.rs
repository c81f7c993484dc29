//! Supervisor side: the session of a command, its temporary folder and unfinished files, which are removed when it ends
//! or is interrupted; and how its worker processes are started.

use std::ffi::OsString;
use std::fs::{self, DirEntry, File};
use std::io;
use std::path::Path;
use std::process::{self, Command, ExitCode};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use fmu_file::replace::remove_unfinished;
use fmu_worker::ProcessOwned;
use signal_hook::consts::{SIGINT, SIGTERM};
use tempfile::TempDir;

use crate::ui;
use crate::worker;

/// A command in progress. All temporary folders are in one, which is removed with this value.
pub struct Session {
    folder: ProcessOwned<TempDir>,
    /// Locked while this process lives.
    _lock: File,
    signal: Arc<AtomicUsize>,
}

/// The time within which a process has locked its folder.
const STARTING: Duration = Duration::from_secs(10);
/// Interval between checks for a signal.
const PERIOD: Duration = Duration::from_millis(20);

impl Session {
    /// Creates the folder for all temporary files of this process, and catches Ctrl-C and SIGTERM.
    ///
    /// # Errors
    /// The folder for temporary files cannot be written.
    pub fn start() -> Result<Self> {
        let session = Self::without_signals()?;
        // Another session of this process has set the folder before.
        let _ = tempfile::env::override_temp_dir(session.folder());
        for number in [SIGINT, SIGTERM] {
            let signal = Arc::clone(&session.signal);
            signal_hook::flag::register_usize(number, signal, number as usize)?;
        }
        Ok(session)
    }

    /// Creates the folder, in a process that handles signals itself.
    ///
    /// # Errors
    /// The folder for temporary files cannot be written.
    pub fn without_signals() -> Result<Self> {
        let parent = std::env::temp_dir();
        remove_abandoned(&parent);
        let create = || {
            let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(&parent)?;
            let lock = lock(folder.path())?;
            io::Result::Ok((folder, lock))
        };
        let created = create();
        let (folder, lock) =
            created.with_context(|| format!("cannot write to the folder {}", parent.display()))?;
        Ok(Self { folder: ProcessOwned::new(folder), _lock: lock, signal: Arc::default() })
    }

    /// The folder for temporary files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The signal that was caught, if any.
    pub fn signal(&self) -> Option<u8> {
        match self.signal.load(Relaxed) {
            0 => None,
            number => u8::try_from(number).ok(),
        }
    }

    /// Starts a session that ends the process when a signal is caught, without leaving temporary files
    /// behind.
    ///
    /// # Errors
    /// As [`Session::start`].
    pub fn end_when_interrupted() -> Result<Self> {
        let session = Self::start()?;
        let (signal, folder) = (Arc::clone(&session.signal), session.folder.path().to_owned());
        thread::spawn(move || {
            loop {
                thread::sleep(PERIOD);
                let number = signal.load(Relaxed);
                if number != 0 {
                    remove_unfinished();
                    // What cannot be removed is in the folder for temporary files.
                    let _ = std::fs::remove_dir_all(&folder);
                    ui::message(format_args!("interrupted; unfinished files were removed"));
                    process::exit(128 + number as i32);
                }
            }
        });
        Ok(session)
    }
}

/// A program and its first arguments, which start this command line.
static PROGRAM: OnceLock<Vec<OsString>> = OnceLock::new();

/// Notes the words that start this command line; if there are none, the file of this process does.
pub fn set_program(program: Vec<OsString>) {
    // Only tests start it twice, in the same way.
    let _ = PROGRAM.set(program);
}

/// The words after the command line that start a worker process for the master.
pub const WORKER: [&str; 2] = [worker::COMMAND, "master"];
/// The same for the validator.
pub const VALIDATOR: [&str; 2] = [worker::COMMAND, "validator"];

/// The words that start this command line: a program and its first arguments.
///
/// # Errors
/// The system does not tell the file of this program.
pub fn program() -> io::Result<Vec<OsString>> {
    match PROGRAM.get() {
        Some(program) if !program.is_empty() => Ok(program.clone()),
        _ => Ok(vec![std::env::current_exe()?.into()]),
    }
}

/// A command that starts a worker process for the master.
///
/// # Errors
/// As [`program`].
pub fn worker() -> io::Result<Command> {
    let program = program()?;
    let mut command = Command::new(&program[0]);
    command.args(&program[1..]).args(WORKER);
    Ok(command)
}

/// The start of the names of the folders, and the name of the file in them that is locked.
const PREFIX: &str = "cargo-fmu-";
const LOCK: &str = "lock";
/// The extension of a folder that this process, or a worker of a killed one, has begun to remove.
const LEFT: &str = "left";

/// Creates the locked file of a session; it has its name only once it is locked.
fn lock(folder: &Path) -> io::Result<File> {
    let unlocked = folder.join(".lock");
    let file = File::create(&unlocked)?;
    // File systems without locks keep what a killed process leaves.
    let _ = file.lock();
    fs::rename(unlocked, folder.join(LOCK))?;
    Ok(file)
}

/// Removes the folders of sessions that were killed.
fn remove_abandoned(parent: &Path) {
    let entries = fs::read_dir(parent).into_iter().flatten().flatten();
    for entry in entries.filter(|e| e.file_name().to_string_lossy().starts_with(PREFIX)) {
        let folder = entry.path();
        let is_abandoned = match File::open(folder.join(LOCK)) {
            Ok(lock) => lock.try_lock().is_ok(),
            Err(error) => error.kind() == io::ErrorKind::NotFound && is_old(&entry),
        };
        let left = folder.with_extension(LEFT);
        // It may be of another user.
        let _ = match folder == left || is_abandoned {
            true => fs::rename(&folder, &left).and_then(|()| fs::remove_dir_all(left)),
            false => Ok(()),
        };
    }
}

/// Whether a folder is so old that its process, if it still ran, would have locked it.
fn is_old(folder: &DirEntry) -> bool {
    let modified = folder.metadata().and_then(|metadata| metadata.modified());
    modified.is_ok_and(|modified| modified.elapsed().is_ok_and(|age| age > STARTING))
}

/// The exit code of a process that a signal has ended, as shells report it.
pub fn code(signal: u8) -> ExitCode {
    ExitCode::from(128 + signal)
}
