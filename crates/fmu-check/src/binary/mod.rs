//! Tests that run a binary, each in its own process, since the binary may crash, hang or exit.

pub mod child;
mod inputs;
mod probes;
mod process;
pub mod rules;
mod run;
mod subject;
mod values;

use std::collections::HashSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use fmu_description::ModelDescription;
use fmu_description::xml::Element;
use fmu_file::archive::Archive;
use fmu_file::platform::{Platform, is_for_this_processor};

use super::finding::Findings;
use crate::Rule;
use child::Task;
use inputs::Level;
use probes::{EXPERIMENT, HEAP_CHECK, IDENTITY, PROBES, Probe, READABLE, TRACE, TRACE_LOGGING};
use process::{Outcome, Workshop};
use rules::{INDEPENDENT, INITIALISED, NOT_RUN, REPRODUCIBLE, SURVIVES_MISUSE};
use values::Trajectory;

/// How to start a test process, and how much to test.
#[derive(Debug)]
pub struct Probes {
    /// The program to start.
    pub program: PathBuf,
    /// Its arguments, for which it calls [`crate::probe`].
    pub arguments: Vec<OsString>,
    /// Time limit of each test.
    pub time_limit: Duration,
    /// Whether to run only a few tests, with inputs at their start values.
    pub is_quick: bool,
}

/// Number of steps of a quick test, and maximum number of a short run.
const FEW_STEPS: usize = 5;
const SHORT_RUN: usize = 300;
/// Maximum duration of a short run, as a fraction of the time limit of a test.
const SHORT_TIME: f64 = 0.03;

/// Runs the binaries built for this machine, if there are any. `text` is the model description.
pub fn check(
    text: &str,
    model: &ModelDescription<'_>,
    archive: &mut Archive,
    probes: &Probes,
    findings: &mut Findings,
) {
    let Some(platform) = Platform::of_this_machine(model.version) else {
        return;
    };
    let interfaces = ["CoSimulation", "ModelExchange"].into_iter();
    let interfaces = interfaces.filter_map(|interface| model.root.child(interface));
    let binaries: Vec<(&Element<'_>, String)> = interfaces
        .filter_map(|e| Some((e, platform.binary(e.attribute("modelIdentifier")?))))
        .filter(|(_, binary)| archive.names.contains(binary))
        .collect();
    if binaries.is_empty() {
        // An FMU without binaries has sources, or the lack of both has been reported.
        if archive
            .names
            .iter()
            .any(|name| name.starts_with("binaries/"))
        {
            let folder = platform.folder;
            let text = format!("there is none for this machine ({folder}); no binary was run");
            findings.add(&NOT_RUN, "binaries", text);
        }
        return;
    }
    for (_, binary) in &binaries {
        let head = archive.head(binary, Platform::HEAD);
        if head.is_ok_and(|head| !is_for_this_processor(&head)) {
            let text = "it is built for another processor; no binary was run";
            return findings.add(&NOT_RUN, binary.as_str(), text);
        }
    }
    let mut run_all = || -> Result<()> {
        let workshop = Workshop::new(text, archive, platform, probes)?;
        let mut checker = Checker {
            workshop: &workshop,
            model,
            element: binaries[0].0,
            task: workshop.task(),
            seen: HashSet::new(),
            about: "",
            findings,
        };
        for (element, binary) in &binaries {
            checker.begin(element, binary);
            checker.run(probes.is_quick)?;
            checker.about = "model exchange: ";
        }
        workshop.report_files(checker.findings)
    };
    if let Err(error) = run_all() {
        findings.add(&NOT_RUN, "binaries", format!("cannot be run: {error:#}"));
    }
}

/// The tests of the binaries.
struct Checker<'a> {
    workshop: &'a Workshop<'a>,
    model: &'a ModelDescription<'a>,
    /// The interface type under test.
    element: &'a Element<'a>,
    /// The task, but for the test.
    task: Task,
    /// What was found, whatever the FMU declares. Tests make the same calls, so that they find the same.
    seen: HashSet<String>,
    /// Stands before what is found, if the FMU has another interface type.
    about: &'static str,
    findings: &'a mut Findings,
}

impl<'a> Checker<'a> {
    /// Goes on to an interface type. Variables that were ignored stay so.
    fn begin(&mut self, element: &'a Element<'a>, binary: &str) {
        self.element = element;
        self.seen.clear();
        self.task = Task {
            interface: element.name.to_owned(),
            binary: binary.to_owned(),
            ignored: std::mem::take(&mut self.task.ignored),
            ..self.workshop.task()
        };
    }

    fn run(&mut self, is_quick: bool) -> Result<()> {
        for probe in [IDENTITY, READABLE] {
            let outcome = self.test(probe)?;
            // An FMU that cannot be loaded or initialized would fail all other tests too.
            if outcome.fails(probe) {
                return Ok(());
            }
            self.task.ignored.extend(outcome.unreadable);
        }
        if !self.experiment(is_quick)? {
            return Ok(());
        }
        if !is_quick {
            self.compare_processes()?;
        }
        let applies = |probe: &&Probe| probe.applies(self.element, self.model.version);
        let probes: Vec<&Probe> = PROBES.iter().filter(applies).collect();
        for probe in probes
            .into_iter()
            .filter(|probe| probe.is_quick() || !is_quick)
        {
            let outcome = self.test(probe)?;
            let mut found = outcome.found.iter();
            self.task.is_fragile |= found.any(|(rule, _)| **rule == SURVIVES_MISUSE);
        }
        Ok(())
    }

    /// Runs the default experiment with the strongest excitation that the FMU accepts; returns whether
    /// there is one with which it runs.
    fn experiment(&mut self, is_quick: bool) -> Result<bool> {
        let levels = match is_quick {
            true => &[Level::Still],
            false => Level::ALL.as_slice(),
        };
        for level in levels {
            self.task.level = *level;
            let outcome = self.test(EXPERIMENT)?;
            if let Some((steps, seconds)) = outcome.ran.filter(|_| !outcome.is_refused) {
                self.task.steps = self.short(is_quick, steps, seconds);
                return Ok(true);
            }
            // A crash has been reported; the other tests then use a weaker excitation.
        }
        Ok(false)
    }

    /// The number of steps of a short run, given that some steps took this many seconds. Two short runs
    /// fit into the default experiment.
    fn short(&self, is_quick: bool, steps: usize, seconds: f64) -> usize {
        if is_quick {
            return FEW_STEPS.min(steps / 2).max(1);
        }
        let time = SHORT_TIME * self.task.seconds as f64;
        let affordable = time / (seconds / steps.max(1) as f64).max(1e-9);
        SHORT_RUN.min(steps / 2).min(affordable as usize).max(1)
    }

    /// Makes the same run in several processes that differ in what must not matter.
    fn compare_processes(&mut self) -> Result<()> {
        /// Values may differ by this much, relative to their size, for reasons such as the alignment of
        /// memory.
        const ROUNDING: f64 = 1e-9;
        // glibc fills memory with a pattern when it is allocated.
        const PATTERN: &[(&str, &str)] = &[
            ("MALLOC_PERTURB_", "85"),
            ("GLIBC_TUNABLES", "glibc.malloc.perturb=85"),
        ];
        let observed = subject::observed(self.model, &self.task.ignored);
        let (Some(expected), Some(again)) = (self.trace(TRACE, &[])?, self.trace(TRACE, &[])?)
        else {
            return Ok(());
        };
        let volatile: HashSet<String> = observed
            .differences(&again, &expected, 0.0)
            .map(|difference| difference.variable.name.clone())
            .collect();
        if let Some(first) = observed.difference(&again, &expected, ROUNDING) {
            let others = match volatile.len() - 1 {
                0 => String::new(),
                more => format!("; so do {more} more variables"),
            };
            let text = first.told("in a second process", " as in the first");
            self.add(
                &REPRODUCIBLE,
                format!("two equal runs differ: {text}{others}"),
            );
        }
        self.check_heap()?;
        for (probe, variables, rule, when) in [
            (TRACE, PATTERN, &INITIALISED, "when new memory is not zero"),
            (
                TRACE_LOGGING,
                &[],
                &INDEPENDENT,
                "with another instance name and logging",
            ),
        ] {
            let Some(trace) = self.trace(probe, variables)? else {
                continue;
            };
            let mut differences = observed.differences(&trace, &expected, 0.0);
            if let Some(first) = differences.find(|d| !volatile.contains(&d.variable.name)) {
                let text = first.told(when, "");
                drop(differences);
                self.add(rule, text);
            }
        }
        // Such as the time that the FMU has used, or addresses: they differ in all other tests, too.
        self.task.ignored.extend(volatile);
        Ok(())
    }

    /// The rows of a short run; `None` if it failed, which is a finding of its own.
    fn trace(
        &mut self,
        probe: &'static Probe,
        variables: &[(&str, &str)],
    ) -> Result<Option<Trajectory>> {
        let outcome = self.test_with(probe, variables)?;
        Ok((!outcome.fails(probe)).then_some(outcome.rows))
    }

    /// Runs with the allocator of glibc that checks the heap, where it is installed.
    fn check_heap(&mut self) -> Result<()> {
        const LIBRARY: &str = "libc_malloc_debug.so.0";
        let own = format!("{}-linux-gnu", std::env::consts::ARCH);
        let folders = ["/lib", "/lib64", "/usr/lib", "/usr/lib64"].map(Path::new);
        let files = folders
            .iter()
            .flat_map(|f| [f.join(LIBRARY), f.join(&own).join(LIBRARY)]);
        if let Some(file) = files.into_iter().find(|file| file.is_file()) {
            let variables = [
                ("LD_PRELOAD", file.to_str().unwrap_or_default()),
                ("GLIBC_TUNABLES", "glibc.malloc.check=3"),
            ];
            self.test_with(HEAP_CHECK, &variables)?;
        }
        Ok(())
    }

    /// Runs a test and adds what it finds.
    fn test(&mut self, probe: &'static Probe) -> Result<Outcome> {
        self.test_with(probe, &[])
    }

    /// As [`Checker::test`], with these environment variables.
    fn test_with(&mut self, probe: &'static Probe, variables: &[(&str, &str)]) -> Result<Outcome> {
        let mut task = Task {
            probe: probe.name.to_owned(),
            seconds: probe.seconds(self.task.seconds),
            ..self.task.clone()
        };
        let mut outcome = self.workshop.run(probe, &task, variables)?;
        if !outcome.found.is_empty() && !outcome.has_message && !outcome.timed_out {
            // Once more, to quote what the FMU has to say.
            task.logging = true;
            let second = self.workshop.run(probe, &task, variables)?;
            if second.has_message && second.rules() == outcome.rules() {
                outcome = second;
            }
        }
        for (rule, text) in &outcome.found {
            self.add(rule, text.clone());
        }
        Ok(outcome)
    }

    fn add(&mut self, rule: &'static Rule, text: String) {
        let cause = text
            .split_once(", but: ")
            .map_or(text.as_str(), |(_, cause)| cause);
        if self.seen.insert(cause.to_owned()) {
            let text = format!("{}{text}", self.about);
            self.findings.add(rule, self.task.binary.as_str(), text);
        }
    }
}
