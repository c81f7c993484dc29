//! Tests that run a binary, each in its own process, since the binary may crash, hang or exit.

mod checker;
mod clock_updates;
mod clocks;
mod exchange;
mod excitation;
mod observed;
mod partitions;
mod probes;
mod report;
mod run;
mod schedule;
mod subject;
mod task;
mod vocabulary;
mod worker;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Instant, SystemTime};

use anyhow::Result;
use fmu_description::xml::Element;
use fmu_description::{ModelDescription, Type, XmlVariable};
use fmu_file::archive::{Archive, MODEL_DESCRIPTION};
use fmu_file::platform::{Platform, is_for_this_processor};
use fmu_file::text::quote;
use fmu_worker::available_memory;
use tempfile::TempDir;

use crate::binary::checker::{COMPILED, Checker, MEMORY, WORK};
use crate::binary::task::{FMU, Task};
use crate::binary::vocabulary::{ONLY_ONCE, claims};
use crate::finding::{Findings, find};
use crate::rule::rule;
pub use checker::Probes;
pub use worker::run as probe;

/// The interface type whose model partitions the host activates.
const SCHEDULED: &str = "ScheduledExecution";

/// The sizes of files, and the times of their last changes.
type Files = BTreeMap<PathBuf, (u64, Option<SystemTime>)>;

/// Runs the binaries built for this machine or the WebAssembly components, if there are any, until the deadline. `text`
/// is the model description. `compiled` is the FMU with binaries that were compiled from its sources: they are run if
/// the FMU has none for this machine, or else compared with those that it has.
pub fn check(
    text: &str,
    model: &ModelDescription<'_>,
    archive: &mut Archive,
    compiled: Option<&mut Archive>,
    probes: &Probes,
    deadline: Instant,
    findings: &mut Findings,
) {
    let native = Platform::of_this_machine(model.version).filter(|_| !probes.sandbox);
    let component = Platform::component(model.version).filter(|_| cfg!(feature = "sandbox"));
    let platforms = Vec::from_iter(native.into_iter().chain(component));
    let interfaces = interfaces(model);
    let binaries = |platform: &Platform, archive: &Archive| -> Vec<(&Element<'_>, String)> {
        // Components have no scheduled execution.
        let has_it = |e: &&Element<'_>| Some(*platform) == native || e.name != SCHEDULED;
        (interfaces.into_iter().flatten().filter(has_it))
            .filter_map(|e| Some((e, platform.binary(e.attribute("modelIdentifier")?))))
            .filter(|(_, binary)| archive.names.contains(binary))
            .collect()
    };
    let has_own = native.is_some_and(|native| !binaries(&native, archive).is_empty());
    let (archive, compared, subject) = match compiled.filter(|_| native.is_some()) {
        Some(compiled) if !has_own => (compiled, None, COMPILED),
        compared => (archive, compared, ""),
    };
    let all = platforms.iter().map(|platform| (*platform, binaries(platform, archive)));
    let Some((platform, binaries)) = all.into_iter().find(|(_, found)| !found.is_empty()) else {
        // An FMU without binaries has sources, or the lack of both has been reported.
        let mut names = archive.names.iter();
        if names.any(|name| name.starts_with("binaries/")) {
            let folders = Vec::from_iter(platforms.iter().map(|platform| platform.folder));
            let text = match interfaces {
                [None, None, None] => "there is no interface type that is tested".into(),
                _ if folders.is_empty() => "--sandbox allows components only".into(),
                _ => format!("there is none for this machine ({})", folders.join(", ")),
            };
            find!(findings, "binary-not-run" at "binaries", "{text}; no binary was run");
        }
        return;
    };
    for (_, binary) in &binaries {
        let head = archive.head(binary, Platform::HEAD);
        if head.is_ok_and(|head| !is_for_this_processor(&head)) {
            let text = "it is built for another processor; no binary was run";
            return findings.add(rule!("binary-not-run"), binary.as_str(), text);
        }
    }
    let run_all = || -> Result<()> {
        let session = unpack(text, archive, platform)?;
        let compared = compared.map(|compiled| unpack(text, compiled, platform)).transpose()?;
        let files = list(&session.path().join(FMU))?;
        let (mut ignored, mut seen) = (HashSet::new(), HashMap::new());
        let (mut is_alone, mut untested, mut broken) =
            (false, untested(model, probes.is_quick), HashMap::new());
        if model.scheduled_execution().is_some() && Some(platform) != native {
            untested.push("scheduled execution".into());
        }
        for ((element, binary), others) in binaries.iter().zip((1..=binaries.len() as u32).rev()) {
            let now = Instant::now();
            let mut checker = Checker {
                model,
                probes,
                element,
                task: Task {
                    interface: element.name.to_owned(),
                    session: session.path().to_owned(),
                    binary: binary.clone(),
                    seconds: probes.time_limit.as_secs(),
                    is_quick: probes.is_quick,
                    is_alone: is_alone || claims(element, ONLY_ONCE, model.version),
                    ignored,
                    ..Task::default()
                },
                seen,
                broken,
                longest: 0.0,
                compiled: compared.as_ref().map(|session| session.path().to_owned()),
                compared_steps: 0,
                untested,
                workers: workers(element),
                deadline: now + deadline.saturating_duration_since(now) / others,
                left_out: Vec::new(),
                about: about(subject == COMPILED, binaries[0].0, element),
                findings,
            };
            checker.run()?;
            let task = checker.task;
            (ignored, seen) = (task.ignored, checker.seen);
            (is_alone, untested, broken) = (task.is_alone, checker.untested, checker.broken);
        }
        untested.dedup();
        if !untested.is_empty() {
            let text = format!("not tested: {}", untested.join(", "));
            findings.add(rule!("not-tested"), binaries[0].1.as_str(), text);
        }
        report_files(session.path(), &files, findings)
    };
    if let Err(error) = run_all() {
        findings.add(rule!("binary-not-run"), "binaries", format!("cannot be run: {error:#}"));
    }
}

/// The interface types that are tested, in their order.
fn interfaces<'a>(model: &ModelDescription<'a>) -> [Option<&'a Element<'a>>; 3] {
    [model.co_simulation(), model.model_exchange(), model.scheduled_execution()]
}

/// What stands before findings on an interface type, which is not the first.
fn about(is_compiled: bool, first: &Element<'_>, element: &Element<'_>) -> &'static str {
    match (is_compiled, element.name) {
        (true, name) if name == first.name => COMPILED,
        (false, name) if name == first.name => "",
        (true, "ModelExchange") => "compiled sources: model exchange: ",
        (false, "ModelExchange") => "model exchange: ",
        (true, _) => "compiled sources: scheduled execution: ",
        (false, _) => "scheduled execution: ",
    }
}

/// How many tests run at the same time: one on each core, if there is memory for all of them. A tool that an FMU needs
/// may be there only once.
pub fn workers(interface: &Element<'_>) -> usize {
    if interface.is_true("needsExecutionTool") {
        return 1;
    }
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let fit = available_memory().map_or(cores, |memory| (memory / MEMORY) as usize);
    cores.min(fit).max(1)
}

/// Unpacks an FMU, whose model description is `text`, to a folder for its tests.
fn unpack(text: &str, archive: &mut Archive, platform: Platform) -> Result<TempDir> {
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
    Ok(session)
}

/// Reports the files that the FMU has written: those that differ from what was in its folder before.
fn report_files(session: &Path, before: &Files, findings: &mut Findings) -> Result<()> {
    /// Maximum number of files that a finding names.
    const MAX_NAMES: usize = 5;
    let mut of_fmu = list(&session.join(FMU))?;
    of_fmu.retain(|path, content| before.get(path) != Some(content));
    // Each worker has a working directory of its own, and what is beside these was written to `..`.
    let seen_there = |(path, content): (PathBuf, _)| match path.iter().count() {
        1 => (Path::new("..").join(path), content),
        _ => (path.iter().skip(1).collect(), content),
    };
    let written: Files = list(&session.join(WORK))?.into_iter().map(seen_there).collect();
    for (files, place) in [(of_fmu, "the folder of the FMU"), (written, "the working directory")] {
        let names = files.keys().take(MAX_NAMES).map(|path| quote(&path.to_string_lossy()));
        let names: Vec<_> = names.collect();
        if !names.is_empty() {
            let (count, names) = (files.len(), names.join(", "));
            let text =
                format!("files written to {place}: {names} ({count} in total), expected none");
            findings.add(rule!("files"), "binaries", text);
        }
    }
    Ok(())
}

/// The parts of an FMU that no test covers. Quick tests leave out most abilities of an FMU anyway.
pub fn untested(model: &ModelDescription<'_>, is_quick: bool) -> Vec<String> {
    let has = |test: fn(&XmlVariable<'_>) -> bool| model.variables().any(|(_, v)| test(v));
    let interfaces = interfaces(model);
    let claims = |flag| {
        let mut all = interfaces.into_iter().flatten();
        all.any(|element| claims(element, flag, model.version))
    };
    let derives = claims("providesDirectionalDerivative") || claims("providesAdjointDerivatives");
    let types = [
        ("Binaries without clocks", has(|v| v.of_type == Type::Binary && v.clocks.is_empty())),
        ("arrays of Strings", has(|v| v.of_type == Type::String && !v.dimensions.is_empty())),
    ];
    let abilities = [
        (
            "derivatives of arrays",
            derives && has(|v| v.of_type.is_float() && !v.dimensions.is_empty()),
        ),
        ("variables in intermediate updates", has(|v| v.element.is_true("intermediateUpdate"))),
        ("dependencies of elements", claims("providesPerElementDependencies")),
        ("asynchronous steps", claims("canRunAsynchronuously")),
    ];
    let abilities = abilities.iter().filter(|_| !is_quick);
    let all = types.iter().chain(abilities).filter(|(_, is_there)| *is_there);
    all.map(|(part, _)| (*part).to_owned()).collect()
}

/// The files in a folder and its folders, by their paths in it.
fn list(folder: &Path) -> Result<Files> {
    let mut files = Files::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(inner)? {
            let entry = entry?;
            match entry.metadata() {
                Ok(data) if data.is_dir() => folders.push(entry.path()),
                Ok(data) => {
                    let path = entry.path();
                    let name = path.strip_prefix(folder).unwrap_or(&path).to_owned();
                    files.insert(name, (data.len(), data.modified().ok()));
                }
                // Removed meanwhile.
                Err(_) => {}
            }
        }
    }
    Ok(files)
}
