//! The processes of tests, and the folders in which they run.

use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::platform::Platform;
use fmu_file::text::quote;
use fmu_worker::{Ended, Event, Function, Limits, Moment, Worker};
use tempfile::TempDir;

use super::Probes;
use super::child::{self, Reply, Task};
use super::inputs::Level;
use super::probes::Probe;
use super::rules::{self, FILES, OUTPUT};
use super::values::Trajectory;
use crate::{Findings, Rule};

/// Maximum memory of a test process.
const MEMORY: u64 = 4 << 30;
/// Time in which a process ends after its test.
const GRACE: Duration = Duration::from_secs(2);
/// Maximum number of files that a finding names.
const MAX_NAMES: usize = 5;

// Folders next to each other: of the unpacked FMU, and the working directory of the tests.
const FMU: &str = "fmu";
const WORK: &str = "work";

/// What files contain: their sizes and the times of their last changes.
type Files = BTreeMap<PathBuf, (u64, Option<SystemTime>)>;

/// The unpacked FMU, and the folders of the tests next to it.
pub struct Workshop<'a> {
    session: TempDir,
    probes: &'a Probes,
    /// The files of the FMU before the tests.
    files: Files,
}

/// The outcome of a test.
#[derive(Default)]
pub struct Outcome {
    /// The findings, with their texts.
    pub found: Vec<(&'static Rule, String)>,
    /// Variables that cannot be read.
    pub unreadable: Vec<String>,
    /// The number of steps of the default experiment, and their duration in s.
    pub ran: Option<(usize, f64)>,
    /// Whether the FMU refused the excitation.
    pub is_refused: bool,
    /// The rows of a run.
    pub rows: Trajectory,
    /// Whether the FMU has logged a problem.
    pub has_message: bool,
    /// Whether the process was killed after its time.
    pub timed_out: bool,
}

impl Outcome {
    /// Whether the test itself has failed, besides what else it has found.
    pub fn fails(&self, probe: &Probe) -> bool {
        let mut found = self.found.iter();
        found.any(|(rule, _)| *rule == probe.rule || *rule == probe.crash())
    }

    /// The rules of the findings.
    pub fn rules(&self) -> Vec<&'static str> {
        self.found.iter().map(|(rule, _)| rule.id).collect()
    }

    fn add(&mut self, reply: Reply) {
        match reply {
            Reply::Found(id, text) => {
                self.found.extend(rules::find(&id).map(|rule| (rule, text)));
            }
            Reply::Unreadable(name) => self.unreadable.push(name),
            Reply::Ran(steps, seconds) => self.ran = Some((steps, seconds)),
            Reply::Refused => self.is_refused = true,
            Reply::Row(time, row) => self.rows.push((time, row)),
            Reply::Done => {}
        }
    }
}

impl<'a> Workshop<'a> {
    /// Unpacks an FMU, whose model description is `text`.
    pub fn new(
        text: &str,
        archive: &mut Archive,
        platform: Platform,
        probes: &'a Probes,
    ) -> Result<Self> {
        let session = tempfile::Builder::new().prefix("fmu-validate-").tempdir()?;
        let fmu = session.path().join(FMU);
        // FMUs may look for their resources where the standard says that they are.
        fs::create_dir_all(fmu.join("resources"))?;
        fs::create_dir(session.path().join(WORK))?;
        fs::write(session.path().join(MODEL_DESCRIPTION), text)?;
        let binaries = format!("binaries/{}/", platform.folder);
        for prefix in [MODEL_DESCRIPTION, "resources/", &binaries] {
            archive.unpack(prefix, &fmu)?;
        }
        let files = list(&fmu)?;
        Ok(Self {
            session,
            probes,
            files,
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.session.path().join(name)
    }

    /// A task without a test and a binary.
    pub fn task(&self) -> Task {
        Task {
            probe: String::new(),
            interface: String::new(),
            model: self.path(MODEL_DESCRIPTION),
            folder: self.path(FMU),
            binary: String::new(),
            level: Level::Still,
            steps: 0,
            seconds: self.probes.time_limit.as_secs(),
            logging: false,
            is_fragile: false,
            ignored: HashSet::new(),
        }
    }

    /// Runs one test in a child process, with these environment variables.
    pub fn run(&self, probe: &Probe, task: &Task, variables: &[(&str, &str)]) -> Result<Outcome> {
        let printed = self.path("printed");
        let output = File::create(&printed)?;
        let mut command = Command::new(&self.probes.program);
        command
            .args(&self.probes.arguments)
            .current_dir(self.path(WORK))
            .envs(variables.iter().copied())
            .stdout(output.try_clone()?)
            .stderr(output);
        let limits = Limits {
            task: Some(Duration::from_secs(task.seconds)),
            memory: Some(MEMORY),
            ..Limits::default()
        };
        let worker = Worker::start(&mut command, self.session.path(), limits);
        let mut worker =
            worker.with_context(|| format!("cannot start {}", self.probes.program.display()))?;
        worker.send(task);
        let mut outcome = Outcome::default();
        let ended = loop {
            match worker.wait()? {
                Event::Ended(ended) => {
                    outcome.timed_out = matches!(ended, Ended::TimedOut(_));
                    break ended.to_string();
                }
                Event::Replied => match worker.reply() {
                    Ok(Reply::Done) => break String::new(),
                    Ok(reply) => outcome.add(reply),
                    Err(error) => break format!("has sent {error}"),
                },
            }
        };
        let now = worker.record().now();
        outcome.has_message = !now.message.is_empty();
        if !ended.is_empty() {
            outcome
                .found
                .push((probe.crash(), unfinished(&now, &ended)));
            return Ok(outcome);
        }
        worker.end(GRACE)?;
        if let Some(line) = head(&printed, 1000)?.lines().find(|l| !l.trim().is_empty()) {
            let line = quote(line);
            let text = format!("the FMU printed {line}, expected that it logs by the callback");
            outcome.found.push((&OUTPUT, text));
        }
        Ok(outcome)
    }

    /// Reports the files that the FMU has written.
    pub fn report_files(&self, findings: &mut Findings) -> Result<()> {
        let of_fmu = list(&self.path(FMU))?.into_iter();
        let of_fmu = of_fmu.filter(|(path, content)| self.files.get(path) != Some(content));
        let written = list(&self.path(WORK))?;
        for (files, where_to) in [
            (of_fmu.collect(), "the folder of the FMU"),
            (written, "the working directory"),
        ] {
            if files.is_empty() {
                continue;
            }
            let name = |path: &PathBuf| {
                let name = path.strip_prefix(self.session.path());
                quote(&name.unwrap_or(Path::new("")).to_string_lossy())
            };
            let names: Vec<_> = files.keys().take(MAX_NAMES).map(name).collect();
            let (count, names) = (files.len(), names.join(", "));
            let text = format!("{count} files were written to {where_to}: {names}; expected none");
            findings.add(&FILES, "binaries", text);
        }
        Ok(())
    }
}

/// Describes the call that did not return, given how the process ended.
fn unfinished(now: &Moment, ended: &str) -> String {
    let call = match now.function {
        Some(Function::LOADING) => "loading it",
        function => function.and_then(Function::name).unwrap_or("the test"),
    };
    let stage = match now.stage.as_str() {
        "" => String::new(),
        stage => format!(", {stage},"),
    };
    let how = ended.replace(" and was killed", "");
    let when = now.time.map(|time| format!(" at t = {time} s"));
    let (when, logged) = (when.unwrap_or_default(), child::logged(&now.message));
    format!("{call}{stage} {how}{when}, expected it to return{logged}")
}

/// All files in a folder.
fn list(folder: &Path) -> Result<Files> {
    let mut files = Files::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            match entry.metadata() {
                Ok(data) if data.is_dir() => folders.push(entry.path()),
                Ok(data) => {
                    files.insert(entry.path(), (data.len(), data.modified().ok()));
                }
                // Removed meanwhile.
                Err(_) => {}
            }
        }
    }
    Ok(files)
}

fn head(file: &Path, max: u64) -> Result<String> {
    let mut bytes = Vec::new();
    File::open(file)?.take(max).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
