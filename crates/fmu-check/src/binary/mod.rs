//! Tests that run a binary, each in its own process, since the binary may crash, hang or exit.

pub mod child;
mod excitation;
mod process;
mod record;
mod report;
pub mod rules;
mod run;
mod subject;
mod tests;
mod traces;

use std::collections::HashSet;
use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use fmu_description::{FmiVersion, ModelDescription};
use fmu_file::archive::Archive;
use fmu_file::platform::{Platform, is_for_this_processor};

use super::finding::Findings;
use child::{Kind, Options};
use excitation::Level;
use process::Workshop;
use report::Outcome;
use rules::{NOT_RUN, SURVIVES_MISUSE};
use tests::{EXPERIMENT, IDENTITY, READABLE, TESTS, Test};

/// How to start a test process, and how much to test.
#[derive(Debug)]
pub struct Probes {
    /// The program to start.
    pub program: PathBuf,
    /// Its leading arguments. The program passes all further arguments to [`crate::probe`].
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
        if archive
            .names
            .iter()
            .any(|name| name.starts_with("binaries/"))
        {
            let text = format!(
                "there is none for this machine ({}); no binary was run",
                platform.folder
            );
            findings.add(&NOT_RUN, "binaries", text);
        }
        return;
    }
    if let Some((_, binary)) = kinds.iter().find(|(_, binary)| {
        let head = archive.head(binary, Platform::HEAD);
        head.is_ok_and(|head| !is_for_this_processor(&head))
    }) {
        let text = "it is built for another processor; no binary was run";
        return findings.add(&NOT_RUN, binary.as_str(), text);
    }
    if let Err(error) = run_all(text, &kinds, platform, archive, probes, findings) {
        findings.add(&NOT_RUN, "binaries", format!("cannot be run: {error:#}"));
    }
}

fn run_all(
    text: &str,
    kinds: &[(Kind, String)],
    platform: Platform,
    archive: &mut Archive,
    probes: &Probes,
    findings: &mut Findings,
) -> Result<()> {
    let workshop = Workshop::new(text, archive, platform, probes)?;
    for (kind, binary) in kinds {
        let checker = Checker {
            workshop: &workshop,
            options: Options {
                test: &IDENTITY,
                kind: *kind,
                binary: binary.clone(),
                level: Level::Still,
                steps: FEW_STEPS,
                seconds: probes.time_limit.as_secs(),
                logging: false,
                is_fragile: false,
            },
            seen: HashSet::new(),
            version: findings.version(),
            about: match kind {
                Kind::Me if kinds.len() > 1 => "model exchange: ",
                _ => "",
            },
        };
        checker.run(probes.is_quick, findings)?;
    }
    workshop.report_files(findings)
}

/// The tests of one binary.
struct Checker<'a> {
    workshop: &'a Workshop<'a>,
    options: Options,
    /// The texts of what was found. Tests make the same calls, so that they find the same.
    seen: HashSet<String>,
    version: FmiVersion,
    /// Stands before what is found, if the FMU has another interface type.
    about: &'static str,
}

impl Checker<'_> {
    fn run(mut self, is_quick: bool, findings: &mut Findings) -> Result<()> {
        for test in [&IDENTITY, &READABLE] {
            let outcome = self.test(test, findings)?;
            self.workshop.ignore(&outcome.values)?;
            // An FMU that cannot be loaded or initialized would fail all other tests too.
            if outcome.fails(test) {
                return Ok(());
            }
        }
        if !self.experiment(is_quick, findings)? {
            return Ok(());
        }
        if !is_quick {
            traces::compare(&mut self, findings)?;
        }
        let version = self.version;
        let tests = TESTS.iter().filter(|test| {
            let is_for = test.only_of.is_none_or(|only| only == version);
            is_for && (test.is_quick || !is_quick)
        });
        for test in tests {
            let outcome = self.test(test, findings)?;
            let crashed = outcome
                .found
                .iter()
                .any(|(rule, _)| **rule == SURVIVES_MISUSE);
            self.options.is_fragile |= crashed;
        }
        Ok(())
    }

    /// Runs the default experiment with the strongest excitation that the FMU accepts; returns whether
    /// there is one with which it runs.
    fn experiment(&mut self, is_quick: bool, findings: &mut Findings) -> Result<bool> {
        let levels: &[Level] = match is_quick {
            true => &[Level::Still],
            false => &Level::ALL,
        };
        for level in levels {
            self.options.level = *level;
            let outcome = self.test(&EXPERIMENT, findings)?;
            let steps = outcome.values.iter().find_map(|value| {
                let mut words = value.strip_prefix("steps ")?.split(' ');
                let steps: usize = words.next()?.parse().ok()?;
                Some((steps, words.next()?.parse::<f64>().ok()?))
            });
            if let Some((steps, seconds)) = steps
                && !outcome.values.iter().any(|value| value == "refused")
            {
                self.options.steps = self.short(is_quick, steps, seconds);
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
        let time = SHORT_TIME * self.options.seconds as f64;
        let affordable = time / (seconds / steps.max(1) as f64).max(1e-9);
        SHORT_RUN.min(steps / 2).min(affordable as usize).max(1)
    }

    /// Runs a test and adds what it finds.
    fn test(&mut self, test: &'static Test, findings: &mut Findings) -> Result<Outcome> {
        self.test_with(test, &[], findings)
    }

    /// As [`Checker::test`], with these environment variables.
    fn test_with(
        &mut self,
        test: &'static Test,
        variables: &[(&str, &str)],
        findings: &mut Findings,
    ) -> Result<Outcome> {
        let options = Options {
            test,
            seconds: self.options.seconds.min(test.seconds),
            ..self.options.clone()
        };
        let mut outcome = self.workshop.run(&options, variables)?;
        if !outcome.found.is_empty() && !outcome.has_message && !outcome.timed_out {
            // Once more, to quote what the FMU has to say.
            let logging = Options {
                logging: true,
                ..options
            };
            let second = self.workshop.run(&logging, variables)?;
            if second.has_message && second.rules() == outcome.rules() {
                outcome = second;
            }
        }
        for (rule, text) in &outcome.found {
            self.add(rule, text.clone(), findings);
        }
        Ok(outcome)
    }

    fn add(&mut self, rule: &'static crate::Rule, text: String, findings: &mut Findings) {
        let binary = self.options.binary.as_str();
        if self.seen.insert(text.clone()) {
            findings.add(rule, binary, format!("{}{text}", self.about));
        }
    }
}
