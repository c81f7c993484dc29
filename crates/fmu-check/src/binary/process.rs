//! The processes of tests, and the folders in which they run.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::platform::Platform;
use fmu_file::text::quote;
use fmu_worker::{Ended, Limits};
use tempfile::TempDir;

use super::Probes;
use super::child::{FMU, IGNORED, Options, REPORT, WORK};
use super::report::{CALL_FILE, FILE, MAX_BYTES, Outcome, TIME_FILE};
use super::rules::{FILES, OUTPUT};
use crate::Findings;

/// Maximum memory of a test process.
const MEMORY: u64 = 4 << 30;
/// Maximum number of files that a finding names.
const MAX_NAMES: usize = 5;

/// What files contain: their sizes and the times of their last changes.
type Files = BTreeMap<PathBuf, (u64, Option<SystemTime>)>;

/// The unpacked FMU, and the folders of the tests next to it.
pub struct Workshop<'a> {
    folder: TempDir,
    probes: &'a Probes,
    /// The files of the FMU before the tests.
    files: Files,
}

impl<'a> Workshop<'a> {
    /// Unpacks an FMU.
    pub fn new(
        text: &str,
        archive: &mut Archive,
        platform: Platform,
        probes: &'a Probes,
    ) -> Result<Self> {
        let folder = tempfile::Builder::new().prefix("fmu-validate-").tempdir()?;
        for name in [FMU, REPORT, WORK, "tmp"] {
            fs::create_dir(folder.path().join(name))?;
        }
        let fmu = folder.path().join(FMU);
        // FMUs may look for their resources where the standard says that they are.
        fs::create_dir(fmu.join("resources"))?;
        for prefix in [
            MODEL_DESCRIPTION,
            "resources/",
            &format!("binaries/{}/", platform.folder),
        ] {
            archive.unpack(prefix, &fmu)?;
        }
        fs::write(folder.path().join(REPORT).join(MODEL_DESCRIPTION), text)?;
        let mut workshop = Self {
            folder,
            probes,
            files: Files::new(),
        };
        workshop.files = workshop.list(FMU)?;
        Ok(workshop)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Leaves out these variables from now on.
    pub fn ignore(&self, names: &[String]) -> Result<()> {
        let file = self.path(REPORT).join(IGNORED);
        let mut text = fs::read_to_string(&file).unwrap_or_default();
        for name in names {
            text += &format!("{name}\n");
        }
        Ok(fs::write(file, text)?)
    }

    /// Runs one test in a child process.
    pub fn run(&self, options: &Options, variables: &[(&str, &str)]) -> Result<Outcome> {
        let reports = self.path(REPORT);
        for name in [FILE, TIME_FILE, CALL_FILE] {
            fs::write(reports.join(name), "")?;
        }
        let printed = reports.join("printed");
        let output = File::create(&printed)?;
        let mut command = Command::new(&self.probes.program);
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command
            .args(&self.probes.arguments)
            .args(options.arguments())
            .current_dir(self.path(WORK))
            .env("TMPDIR", self.path("tmp"))
            .envs(variables.iter().copied())
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .spawn()
            .with_context(|| format!("cannot start {}", self.probes.program.display()))?;
        let limits = Limits {
            time: Some(Duration::from_secs(options.seconds)),
            memory: Some(MEMORY),
        };
        let ended = fmu_worker::wait(&mut child, &limits)?;
        let mut outcome = Outcome::read(&head(&reports.join(FILE), MAX_BYTES)?);
        outcome.last_call = head(&reports.join(CALL_FILE), 100)?.trim().to_owned();
        outcome.timed_out = matches!(ended, Ended::TimedOut(_));
        let time = head(&reports.join(TIME_FILE), 100)?;
        let when = match time.trim() {
            "" => String::new(),
            time => format!(" at t = {time} s"),
        };
        let how = format!("{ended}").replace(" and was killed", "");
        if let Some(text) = outcome.unfinished(&format!("{how}{when}")) {
            outcome.found.push((options.test.crash, text));
        } else if let Some(line) = head(&printed, 1000)?.lines().find(|l| !l.trim().is_empty()) {
            let text = format!(
                "the FMU printed {}, expected that it logs by the callback",
                quote(line)
            );
            outcome.found.push((&OUTPUT, text));
        }
        Ok(outcome)
    }

    fn list(&self, folder: &str) -> Result<Files> {
        let mut files = Files::new();
        let mut folders = vec![self.path(folder)];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder)? {
                let (entry, path) = entry.map(|entry| (entry.metadata(), entry.path()))?;
                match entry {
                    Ok(data) if data.is_dir() => folders.push(path),
                    Ok(data) => {
                        files.insert(path, (data.len(), data.modified().ok()));
                    }
                    // Removed meanwhile.
                    Err(_) => {}
                }
            }
        }
        Ok(files)
    }

    /// Reports the files that the FMU has written.
    pub fn report_files(&self, findings: &mut Findings) -> Result<()> {
        let now = self.list(FMU)?;
        let of_fmu = now
            .iter()
            .filter(|(path, content)| self.files.get(*path) != Some(content));
        let written = self.list(WORK)?;
        for (paths, where_to) in [
            (
                of_fmu.map(|(path, _)| path).collect::<Vec<_>>(),
                "the folder of the FMU",
            ),
            (written.keys().collect(), "the working directory"),
        ] {
            if paths.is_empty() {
                continue;
            }
            let name = |path: &&PathBuf| {
                let name = path
                    .strip_prefix(self.folder.path())
                    .unwrap_or(Path::new(""));
                quote(&name.to_string_lossy())
            };
            let names: Vec<_> = paths.iter().take(MAX_NAMES).map(name).collect();
            let (count, names) = (paths.len(), names.join(", "));
            let text = format!("{count} files were written to {where_to}: {names}; expected none");
            findings.add(&FILES, "binaries", text);
        }
        Ok(())
    }
}

fn head(file: &Path, max: u64) -> Result<String> {
    let mut bytes = Vec::new();
    File::open(file)?.take(max).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
