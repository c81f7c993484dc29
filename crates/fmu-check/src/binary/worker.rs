//! The worker process of a test: loads the FMU, runs one probe, and replies what it finds.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use fmu_description::ModelDescription;
use fmu_description::xml;
use fmu_file::archive::MODEL_DESCRIPTION;
use fmu_host::Library;
use fmu_worker::Service;

use crate::binary::probes::Probe;
use crate::binary::report::Reporter;
use crate::binary::subject::Subject;
use crate::binary::task::{FMU, Reply, Task};
use crate::rule::rule;

/// Receives a test of a binary in this process, which [`crate::Probes`] has started, and runs it.
///
/// # Errors
/// The process was not started for a test, or the unpacked FMU cannot be read.
pub fn run() -> Result<()> {
    // A dump of memory in the working directory would count as a file of the FMU.
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, setrlimit};
        let _ = setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) });
    }
    let service = Service::from_env()?;
    let mut service = service.context("it is started by `validate` only")?;
    let task: Task = service.task()?.context("there is no test to run")?;
    let text = std::fs::read_to_string(task.session.join(MODEL_DESCRIPTION))?;
    let root = xml::parse(&text)?;
    let model = ModelDescription::read(&root)?;
    let report = Arc::new(Reporter::new(service, model.version, task.interface_type()));
    let probe = Probe::named(&task.probe)?;
    let folder = task.session.join(FMU);
    let observer = Arc::clone(&report);
    let library = Library::load_observed(&folder.join(&task.binary), model.version, observer);
    let outcome = match &library {
        Ok(library) => {
            let subject = Subject::new(&task, &model, library, &report);
            subject.and_then(|subject| probe.run(&subject))
        }
        Err(error) => Err(error.clone().into()),
    };
    if let Err(error) = outcome {
        // The folder no longer exists when the message is read.
        let text = format!("{error:#}").replace(&format!("{}/", folder.display()), "");
        match lacking(&text).filter(|name| !is_in(&folder, name)) {
            Some(name) if library.is_err() => {
                let text = format!("this machine lacks {name}, which it needs; no binary was run");
                report.add_finding(rule!("binary-not-run"), text);
            }
            _ => report.fail(probe.rule, &text),
        }
    }
    report.reply(&Reply::Tested);
    if probe.unloads() {
        settle();
        drop(library);
    }
    report.reply(&Reply::Done);
    Ok(())
}

/// The library, or the version of one, for want of which another cannot be loaded, from the message of the dynamic
/// loader of Linux.
fn lacking(text: &str) -> Option<&str> {
    let text = text.rsplit_once("cannot be loaded: ").map_or(text, |(_, reason)| reason);
    if let Some((name, _)) = text.split_once(": cannot open shared object file") {
        return Some(name);
    }
    let (_, version) = text.split_once(": version `")?;
    version.split_once("' not found").map(|(version, _)| version)
}

/// Whether a folder or one in it has a file of this name.
fn is_in(folder: &Path, name: &str) -> bool {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).any(|path| path.ends_with(name) || is_in(&path, name))
}

#[test]
fn a_library_that_the_machine_lacks_is_named() {
    let lacks =
        "it cannot be loaded: libgfortran.so.3: cannot open shared object file: No such file";
    assert_eq!(lacking(lacks), Some("libgfortran.so.3"));
    let old =
        "it cannot be loaded: /lib/libc.so.6: version `GLIBC_2.99' not found (required by a.so)";
    assert_eq!(lacking(old), Some("GLIBC_2.99"));
    assert_eq!(lacking("it cannot be loaded: a.so: undefined symbol: f"), None);
}

/// Gives threads that the FMU has left behind the time to end or to wait, since a library whose code runs
/// cannot be unloaded.
fn settle() {
    const USUAL: usize = 2;
    let threads = std::fs::read_dir("/proc/self/task").map_or(0, Iterator::count);
    if threads > USUAL {
        std::thread::sleep(Duration::from_millis(200));
    }
}
