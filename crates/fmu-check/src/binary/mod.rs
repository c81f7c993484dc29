//! Tests that run a binary, each in its own process, since the binary may crash, hang or exit.

pub mod probe;
mod report;
mod run;

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use fmu_description::ModelDescription;
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::platform::{Platform, is_for_this_processor};

use super::finding::Findings;
use probe::{Kind, Probe};
use report::Outcome;

/// How to start a test process.
#[derive(Debug)]
pub struct Probes {
    /// The program to start.
    pub program: PathBuf,
    /// Its leading arguments. The program passes all further arguments to [`crate::probe`].
    pub arguments: Vec<OsString>,
    /// Time limit of each test.
    pub time_limit: Duration,
}

/// Runs the binaries built for this machine, if there are any.
pub fn check(
    model: &ModelDescription<'_>,
    archive: &mut Archive,
    probes: &Probes,
    findings: &mut Findings,
) {
    let Some(platform) = Platform::of_this_machine() else {
        return;
    };
    let kinds: Vec<(Kind, String)> = Kind::ALL
        .into_iter()
        .filter_map(|kind| {
            let identifier = model
                .root
                .child(kind.element())?
                .attribute("modelIdentifier")?;
            Some((kind, platform.binary(identifier)))
        })
        .filter(|(_, binary)| archive.names.contains(binary))
        .collect();
    if kinds.is_empty() {
        // An FMU without binaries has sources, or the lack of both has been reported.
        if !archive
            .names
            .iter()
            .any(|name| name.starts_with("binaries/"))
        {
            return;
        }
        findings.warning(
            "binaries",
            format!(
                "there is none for this machine ({}); no binary was run",
                platform.folder
            ),
        );
        return;
    }
    if let Some((_, binary)) = kinds.iter().find(|(_, binary)| {
        let head = archive.head(binary, Platform::HEAD);
        head.is_ok_and(|head| !is_for_this_processor(&head))
    }) {
        findings.warning(
            binary.as_str(),
            "it is built for another processor; no binary was run",
        );
        return;
    }
    if let Err(error) = run_all(&kinds, platform, archive, probes, findings) {
        findings.error("binaries", format!("cannot be run: {error:#}"));
    }
}

fn run_all(
    kinds: &[(Kind, String)],
    platform: Platform,
    archive: &mut Archive,
    probes: &Probes,
    findings: &mut Findings,
) -> Result<()> {
    let folder = tempfile::Builder::new().prefix("fmu-").tempdir()?;
    for prefix in [
        MODEL_DESCRIPTION,
        "resources/",
        &format!("binaries/{}/", platform.folder),
    ] {
        archive.unpack(prefix, folder.path())?;
    }
    for (kind, binary) in kinds {
        for probe in Probe::ALL {
            let errors = findings.errors();
            run(folder.path(), probe, *kind, binary, probes, findings)?;
            // An FMU that cannot be loaded or simulated would fail all other tests too.
            if probe.is_basic() && findings.errors() > errors {
                break;
            }
        }
    }
    Ok(())
}

/// Runs one test in a child process.
fn run(
    folder: &Path,
    probe: Probe,
    kind: Kind,
    binary: &str,
    probes: &Probes,
    findings: &mut Findings,
) -> Result<()> {
    let log = folder.join("log");
    fs::write(&log, "")?;
    let limit = probes.time_limit;
    let mut child = Command::new(&probes.program)
        .args(&probes.arguments)
        .args([probe.name(), kind.name(), binary])
        .arg(limit.as_secs().to_string())
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .with_context(|| format!("cannot start {}", probes.program.display()))?;
    let status = wait(&mut child, limit)?;
    let mut text = Vec::new();
    File::open(&log)?
        .take(report::MAX_BYTES)
        .read_to_end(&mut text)?;
    let outcome = Outcome::read(&String::from_utf8_lossy(&text), binary, findings);
    if let Some(call) = outcome.unfinished() {
        let how = match status {
            None => format!("did not return within {} s", limit.as_secs()),
            Some(status) => format!("ended the process ({})", describe(status)),
        };
        findings.error(binary, format!("{call} {how}, expected it to return"));
    }
    Ok(())
}

/// Waits for a process; `None` if it had to be killed.
fn wait(child: &mut Child, limit: Duration) -> Result<Option<ExitStatus>> {
    let start = Instant::now();
    let mut pause = Duration::from_millis(1);
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if start.elapsed() >= limit {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(Duration::from_millis(50));
    }
}

fn describe(status: ExitStatus) -> String {
    #[cfg(unix)]
    if let Some(signal) = std::os::unix::process::ExitStatusExt::signal(&status) {
        let name = match signal {
            4 => "illegal instruction",
            6 => "abort",
            8 => "arithmetic error",
            7 | 11 => "illegal memory access",
            _ => "killed",
        };
        return format!("signal {signal}, {name}");
    }
    status.to_string()
}
