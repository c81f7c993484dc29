//! Runs the tests of one interface type in worker processes, and judges how each ends: in the supervisor.

use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Read;
use std::mem;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use fmu_description::ModelDescription;
use fmu_description::xml::Element;
use fmu_file::text::quote;
use fmu_worker::{Ended, Event, Function, Limits, Snapshot, Worker};

use crate::binary::excitation::EXCITATIONS;
use crate::binary::observed::{Difference, MAX_ELEMENTS, Trajectory};
use crate::binary::probes::{INSTANCES, MISTAKES, OTHERS, Probe};
use crate::binary::report::lock;
use crate::binary::task::{Pace, Reply, Task, logged};
use crate::binary::vocabulary::ONLY_ONCE;
use crate::binary::{excitation, observed};
use crate::finding::Findings;
use crate::rule::{RULES, Rule, Severity, rule};

/// How to start a test process, and how much to test.
#[derive(Debug)]
pub struct Probes {
    /// The program to start.
    pub program: PathBuf,
    /// Its arguments, for which it calls [`crate::probe`].
    pub arguments: Vec<OsString>,
    /// Time limit of each call.
    pub time_limit: Duration,
    /// Whether to run only a few tests, with inputs at their start values.
    pub is_quick: bool,
    /// Whether to run WebAssembly components only; by default, they are run if there is no binary for this machine.
    pub sandbox: bool,
}

/// Number of steps of a quick test, and maximum number of a short run.
const FEW_STEPS: usize = 5;
const SHORT_RUN: usize = 300;
/// Maximum number of steps in which the results of compiled sources are compared.
const COMPARED_RUN: usize = 3000;
/// Maximum duration of a short run, as a fraction of the time limit of a call.
const SHORT_TIME: f64 = 0.03;
/// Time limit of a test, relative to the time limit of a call.
const TEST_TIME: u32 = 2;
/// Maximum memory of a test process.
pub const MEMORY: u64 = 4 << 30;
/// Time that a process has to end after its test.
const GRACE: Duration = Duration::from_secs(2);
pub const WORK: &str = "work";
/// What stands before findings on binaries that were compiled from the sources.
pub const COMPILED: &str = "compiled sources: ";

/// A finding of a test.
pub struct ProbeFinding {
    rule: &'static Rule,
    text: String,
    /// The key that findings of other tests with the same cause have, too.
    cause: String,
    is_crash: bool,
    /// Whether it shows that instances share state.
    is_shared_state: bool,
}

impl ProbeFinding {
    fn new(rule: &'static Rule, text: String, cause: String) -> Self {
        let is_shared_state = *rule == *rule!("separate-instances");
        Self { rule, text, cause, is_crash: false, is_shared_state }
    }

    /// What the report says, with the cause and the consequences of state that instances share.
    fn message(&self) -> String {
        let text = &self.text;
        match self.is_shared_state {
            true => format!(
                "the instances share state: {text}; keep the state in each instance, or set {ONLY_ONCE} to true; left \
                 out: tests with several instances, and findings about resets and saved states"
            ),
            false => text.clone(),
        }
    }
}

/// The replies of a process, and how it ended.
#[derive(Default)]
struct ProbeOutcome {
    found: Vec<ProbeFinding>,
    hints: Vec<String>,
    unreadable: Vec<String>,
    ran: Option<Pace>,
    rows: Trajectory,
    has_message: bool,
    /// Whether the process was killed after its time.
    timed_out: bool,
    /// Whether the process ended by itself, or by a call, before its test did.
    is_cut: bool,
    /// Whether there was no time for the test.
    left_out: bool,
}

/// A run of a test.
#[derive(Clone, Copy)]
struct ProbeRun<'a> {
    probe: &'static Probe,
    /// The environment variables of its process, besides the usual ones.
    environment: &'a [(&'a str, &'a str)],
}

impl From<&'static Probe> for ProbeRun<'_> {
    fn from(probe: &'static Probe) -> Self {
        Self { probe, environment: &[] }
    }
}

impl ProbeOutcome {
    /// Whether the test itself has failed, or could not be made, besides what else it has found.
    fn fails(&self, probe: &Probe) -> bool {
        let is_failure = |rule: &Rule| *rule == *probe.rule || *rule == *rule!("binary-not-run");
        self.is_cut || self.found.iter().any(|found| is_failure(found.rule))
    }

    /// The rows of a run, unless it has failed, which is a finding of its own.
    fn trace(self, probe: &Probe) -> Option<Trajectory> {
        (!self.left_out && !self.fails(probe)).then_some(self.rows)
    }

    fn add(&mut self, reply: Reply) {
        match reply {
            Reply::Found(id, text) => {
                let cause = text.split_once(", but: ").map_or(text.as_str(), |(_, cause)| cause);
                let cause = cause.to_owned();
                let rule = RULES.iter().find(|rule| rule.id == id);
                self.found.extend(rule.map(|rule| ProbeFinding::new(rule, text, cause)));
            }
            Reply::Hint(text) => self.hints.push(text),
            Reply::Unreadable(name) => self.unreadable.push(name),
            Reply::Ran(pace) => self.ran = Some(pace),
            Reply::Row(time, row) => self.rows.push((time, row)),
            Reply::Tested => self.is_cut = false,
            Reply::Done => {}
        }
    }
}

pub struct Checker<'a> {
    pub model: &'a ModelDescription<'a>,
    pub probes: &'a Probes,
    pub element: &'a Element<'a>,
    /// The task, but for the test.
    pub task: Task,
    /// What was found, whatever the FMU declares, and how severe it is. Tests make the same calls, so that they find
    /// the same.
    pub seen: HashMap<String, Severity>,
    /// The rules that tests have found broken, and the first of these tests with what stands before its findings.
    pub broken: HashMap<&'static str, [&'static str; 2]>,
    /// The duration of the longest step or of the initialization in s.
    pub longest: f64,
    /// The session of the binary that was compiled from the sources, if it is to be compared.
    pub compiled: Option<PathBuf>,
    /// The number of steps in which it is compared.
    pub compared_steps: usize,
    /// What was not tested, as it cannot be, or the FMU does not allow it.
    pub untested: Vec<String>,
    /// How many tests run at the same time.
    pub workers: usize,
    /// When the time for all tests is over, and the tests that were left out for that.
    pub deadline: Instant,
    pub left_out: Vec<&'static str>,
    /// Stands before what is found, if the FMU has another interface type.
    pub about: &'static str,
    pub findings: &'a mut Findings,
}

/// The library by which glibc checks the heap, where it is installed.
fn heap_checker() -> Option<PathBuf> {
    const LIBRARY: &str = "libc_malloc_debug.so.0";
    let own = format!("{}-linux-gnu", std::env::consts::ARCH);
    let folders = ["/lib", "/lib64", "/usr/lib", "/usr/lib64"].map(Path::new);
    let mut files = folders.iter().flat_map(|f| [f.join(LIBRARY), f.join(&own).join(LIBRARY)]);
    files.find(|file| file.is_file())
}

impl Checker<'_> {
    pub fn run(&mut self) -> Result<()> {
        self.run_tests()?;
        if !self.left_out.is_empty() {
            let (count, names) = (self.left_out.len(), self.left_out.join(", "));
            let tests = if count == 1 { "test" } else { "tests" };
            let text = format!("there was no time for {count} {tests}: {names}");
            self.add(rule!("not-tested"), text);
        }
        Ok(())
    }

    fn run_tests(&mut self) -> Result<()> {
        for (_, variable) in self.model.variables() {
            let (name, n) = (quote(&variable.name), variable.element_count());
            if n > MAX_ELEMENTS {
                let limit = format!("expected at most {MAX_ELEMENTS} for tests");
                self.add(rule!("not-tested"), format!("{name} has {n} elements, {limit}"));
            }
        }
        for name in ["identity", "readable"] {
            let probe = Probe::named(name)?;
            let outcome = self.test(probe)?;
            // An FMU that cannot be loaded or initialized would fail all other tests too.
            if outcome.fails(probe) {
                return Ok(());
            }
            self.task.ignored.extend(outcome.unreadable);
        }
        // Without time, the tests that follow are only named.
        if !self.experiment()? && Instant::now() <= self.deadline {
            return Ok(());
        }
        self.compare_processes()?;
        self.compare_sources()?;
        // One cause is one finding: if instances share state, the other tests make one in each process.
        let runs = self.runs(INSTANCES);
        let outcomes = self.tests(&runs)?;
        let mut pairs = runs.iter().zip(&outcomes);
        if pairs.any(|(run, outcome)| outcome.fails(run.probe)) {
            self.task.is_alone = true;
        }
        if self.task.is_alone {
            let trace = Probe::named("trace")?;
            self.task.usual = self.test(trace)?.trace(trace);
        }
        if let Some(checker) = heap_checker().filter(|_| !self.probes.is_quick) {
            let checker = checker.to_string_lossy();
            let checked = [("LD_PRELOAD", &*checker), ("GLIBC_TUNABLES", "glibc.malloc.check=3")];
            self.tests(&[ProbeRun { probe: Probe::named("heap")?, environment: &checked }])?;
        }
        // Other tests make no mistakes if these crash.
        for group in [MISTAKES, OTHERS] {
            let outcomes = self.tests(&self.runs(group))?;
            let mut found = outcomes.iter().flat_map(|outcome| &outcome.found);
            self.task.is_fragile |= found.any(|found| *found.rule == *rule!("survives-misuse"));
        }
        Ok(())
    }

    /// The tests of a group that apply to the FMU.
    fn runs(&self, group: &'static [Probe]) -> Vec<ProbeRun<'static>> {
        let group = group.iter().filter(|probe| {
            (probe.is_quick() || !self.probes.is_quick)
                && probe.applies(self.element, self.model.version, self.task.is_alone)
        });
        group.map(ProbeRun::from).collect()
    }

    /// Runs the default experiment with the strongest excitation that the FMU accepts; returns whether
    /// there is one with which it runs.
    fn experiment(&mut self) -> Result<bool> {
        let strongest = if self.probes.is_quick { 2 } else { 0 };
        for (excitation, strength) in EXCITATIONS.into_iter().enumerate().skip(strongest) {
            self.task.excitation = excitation;
            let outcome = self.test(Probe::named("experiment")?)?;
            if let Some(pace) = outcome.ran {
                self.task.steps = self.short(pace);
                self.compared_steps = match self.probes.is_quick {
                    true => self.task.steps,
                    false => pace.steps.min(COMPARED_RUN),
                };
                self.longest = pace.longest;
                let has_inputs = !excitation::inputs(self.model).is_empty();
                if excitation > strongest && has_inputs {
                    self.untested.push(match strength {
                        0.0 => "changes of inputs, which it refuses".into(),
                        _ => "larger changes of inputs, which it refuses".into(),
                    });
                }
                return Ok(true);
            }
            // A crash has been reported; the other tests then use a weaker excitation.
        }
        Ok(false)
    }

    /// The number of steps of a short run. Two short runs fit into the default experiment.
    fn short(&self, Pace { steps, seconds, .. }: Pace) -> usize {
        if self.probes.is_quick {
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
        // All numbers made of it are far from 0: 32.5, 1077952576, and so on.
        const PATTERN: &[(&str, &str)] =
            &[("MALLOC_PERTURB_", "191"), ("GLIBC_TUNABLES", "glibc.malloc.perturb=191")];
        let trace = Probe::named("trace")?;
        let mut runs = vec![ProbeRun::from(trace), ProbeRun::from(trace)];
        if !self.probes.is_quick {
            runs.push(ProbeRun { probe: trace, environment: PATTERN });
            runs.push(Probe::named("trace-logging")?.into());
        }
        let outcomes = self.tests(&runs)?;
        let mut traces = runs.iter().zip(outcomes).map(|(run, outcome)| outcome.trace(run.probe));
        let observed = observed::observed(self.model, &self.task.ignored);
        let (Some(Some(expected)), Some(Some(again))) = (traces.next(), traces.next()) else {
            return Ok(());
        };
        let how = ["in a second process", " as in the first"];
        let names = |tolerance| -> HashSet<_> {
            let differences = observed.differences(&again, &expected, tolerance, how);
            differences.iter().map(|d| d.variable.name.clone()).collect()
        };
        let (rounded, volatile) = (names(0.0), names(ROUNDING));
        let differences = observed.differences(&again, &expected, ROUNDING, how);
        if let Some(first) = Difference::first(&differences) {
            let others = match volatile.len() - 1 {
                0 => String::new(),
                more => format!("; other variables that do: {more}"),
            };
            let text = format!("two equal runs differ: {}{others}", first.text);
            self.add(rule!("reproducible"), text);
        }
        let logging = "with another instance name and logging";
        let how = [
            (rule!("initialised-memory"), "when new memory is not zero"),
            (rule!("independent-of-host"), logging),
        ];
        for (trace, (rule, when)) in traces.zip(how) {
            let actual = trace.unwrap_or_default();
            let differences = observed.differences(&actual, &expected, 0.0, [when, ""]);
            let mut differences = differences.into_iter();
            if let Some(first) = differences.find(|d| !rounded.contains(&d.variable.name)) {
                self.add(rule, first.text);
            }
        }
        // Such as the time that the FMU has used, or addresses: they differ in all other tests, too.
        self.task.ignored.extend(volatile);
        Ok(())
    }

    /// Compares the results of the binary with those of the compiled sources. Compilers round differently, so other last
    /// digits are no error.
    fn compare_sources(&mut self) -> Result<()> {
        /// Rounding may have a solver take other steps, whose error is up to this part of a value.
        const ROUNDING: f64 = 1e-3;
        let Some(compiled) = self.compiled.take() else { return Ok(()) };
        let trace = Probe::named("trace")?;
        let steps = mem::replace(&mut self.task.steps, self.compared_steps);
        let expected = self.test(trace)?.trace(trace);
        let own = (
            mem::replace(&mut self.task.session, compiled),
            mem::replace(&mut self.about, COMPILED),
        );
        let actual = self.test(trace);
        (self.task.session, self.about) = own;
        self.task.steps = steps;
        let (Some(expected), Some(actual)) = (expected, actual?.trace(trace)) else {
            return Ok(());
        };
        if actual.len() != expected.len() {
            let (found, expected) = (actual.len(), expected.len());
            let text = format!(
                "the run of the compiled sources has {found} points, expected {expected} as of the binary"
            );
            self.add(rule!("sources-results"), text);
            return Ok(());
        }
        let observed = observed::observed(self.model, &self.task.ignored);
        let first = |tolerance| {
            let how = ["compiled from the sources", " as of the binary"];
            let all = observed.differences(&actual, &expected, tolerance, how);
            Difference::first(&all).map(|difference| difference.text.clone())
        };
        match (first(ROUNDING), first(0.0)) {
            (Some(text), _) => self.add(rule!("sources-results"), text),
            (None, Some(text)) => self.findings.add_hint(&format!("other digits: {text}")),
            (None, None) => {}
        }
        Ok(())
    }

    /// Makes a test, and adds what it finds.
    fn test(&mut self, probe: &'static Probe) -> Result<ProbeOutcome> {
        let outcomes = self.tests(&[probe.into()])?;
        Ok(outcomes.into_iter().next().unwrap_or_default())
    }

    /// Makes tests, several at the same time, and adds what they find in their order.
    fn tests(&mut self, runs: &[ProbeRun<'_>]) -> Result<Vec<ProbeOutcome>> {
        let mut outcomes: Vec<_> = runs.iter().map(|_| Ok(ProbeOutcome::default())).collect();
        let (this, queue) = (&*self, Mutex::new(runs.iter().zip(&mut outcomes)));
        let next = || lock(&queue).next();
        let make_tests = |worker| {
            while let Some((run, outcome)) = next() {
                *outcome = this.attempt(*run, worker);
            }
        };
        thread::scope(|scope| {
            for worker in 0..self.workers.min(runs.len()) {
                scope.spawn(move || make_tests(worker));
            }
        });
        let outcomes: Vec<ProbeOutcome> = outcomes.into_iter().collect::<Result<_>>()?;
        for (ProbeRun { probe, .. }, outcome) in runs.iter().zip(&outcomes) {
            if outcome.left_out && !self.left_out.contains(&probe.name) {
                self.left_out.push(probe.name);
            }
            for hint in &outcome.hints {
                self.findings.add_hint(&format!("{}{hint}", self.about));
            }
            for found in &outcome.found {
                if !self.is_seen_by_another(probe, found) {
                    self.add_once(found);
                }
            }
        }
        Ok(outcomes)
    }

    /// Makes a test in the process of a worker, given by its number.
    fn attempt(&self, run: ProbeRun<'_>, worker: usize) -> Result<ProbeOutcome> {
        if Instant::now() > self.deadline {
            return Ok(ProbeOutcome { left_out: true, ..ProbeOutcome::default() });
        }
        let mut task = Task {
            probe: run.probe.name.to_owned(),
            seconds: run.probe.seconds(self.task.seconds),
            ..self.task.clone()
        };
        let mut outcome = self.process(run, &task, worker)?;
        if !outcome.found.is_empty() && !outcome.has_message && !outcome.timed_out {
            // Once more, to quote what the FMU has to say.
            task.logging = true;
            let second = self.process(run, &task, worker)?;
            let rules = |of: &ProbeOutcome| -> Vec<_> {
                of.found.iter().map(|found| found.rule.id).collect()
            };
            if second.has_message && rules(&second) == rules(&outcome) {
                outcome = second;
            }
        }
        Ok(outcome)
    }

    fn add(&mut self, rule: &'static Rule, text: String) {
        let text = format!("{}{text}", self.about);
        self.findings.add(rule, self.task.binary.as_str(), text);
    }

    /// Adds what a test has found, unless it has the cause of something that is as severe.
    fn add_once(&mut self, found: &ProbeFinding) {
        let ProbeFinding { rule, cause, is_crash, .. } = found;
        let is_seen = |cause: &str| self.seen.get(cause).is_some_and(|of| *of >= rule.severity);
        // A crash that breaks a rule of its own has a cause of its own, unless the function crashes anyway.
        let own = match *is_crash && !["survives", "survives-misuse"].contains(&rule.id) {
            true => format!("{}: {cause}", rule.id),
            false => cause.clone(),
        };
        if !is_seen(cause) && !is_seen(&own) {
            self.seen.insert(own, rule.severity);
            self.add(rule, found.message());
        }
    }

    /// Whether what a test is about was found broken by another test, of the same rule or of one on which it depends.
    /// One cause is one finding.
    fn is_seen_by_another(&mut self, probe: &Probe, found: &ProbeFinding) -> bool {
        /// Rules, and those without which they do not hold.
        const BASES: [(&str, &str); 6] = [
            ("serialized-state", "state"),
            ("adjoint-derivatives", "directional-derivatives"),
            // What instances share is neither reset nor saved with one of them.
            ("reset", "separate-instances"),
            ("after-error", "separate-instances"),
            ("state", "separate-instances"),
            ("serialized-state", "separate-instances"),
        ];
        /// Without them, most tests are not made, and each interface type reports its own reason.
        const GATES: [&str; 2] = ["loads", "runs"];
        let test = [self.about, probe.name];
        // A crash next to another instance is about what they share, though it breaks a rule of its own.
        let rule = if found.is_shared_state { probe.rule.id } else { found.rule.id };
        // A reset is also tested for what NaN leaves behind, by the test that NaN is survived.
        let is_about = rule == probe.rule.id || rule == "reset";
        if !is_about || GATES.contains(&rule) {
            return false;
        }
        let is_broken = |rule| self.broken.get(rule).is_some_and(|by| *by != test);
        let mut bases = BASES.iter().filter(|(of, _)| *of == rule);
        // Each wrong call is a mistake of its own.
        let is_own = probe.is_misuse();
        let is_seen = !is_own && is_broken(&rule) || bases.any(|(_, base)| is_broken(base));
        if !is_own {
            self.broken.entry(rule).or_insert(test);
        }
        is_seen
    }

    /// Runs one test in a worker process.
    fn process(
        &self,
        ProbeRun { probe, environment }: ProbeRun<'_>,
        task: &Task,
        worker: usize,
    ) -> Result<ProbeOutcome> {
        let printed = task.session.join(format!("printed-{worker}"));
        let folder = task.session.join(WORK).join(worker.to_string());
        fs::create_dir_all(&folder)?;
        let output = File::create(&printed)?;
        let mut command = Command::new(&self.probes.program);
        command
            .args(&self.probes.arguments)
            .current_dir(folder)
            .envs(environment.iter().copied())
            .stdout(output.try_clone()?)
            .stderr(output);
        let call = Duration::from_secs(task.seconds);
        let left = self.deadline.saturating_duration_since(Instant::now());
        let limit = (TEST_TIME * call).min(left);
        let limits = Limits { call: Some(call), task: Some(limit), memory: Some(MEMORY) };
        let worker = Worker::start(&mut command, &task.session, limits);
        let mut worker =
            worker.with_context(|| format!("cannot start {}", self.probes.program.display()))?;
        worker.send(task);
        let mut outcome = ProbeOutcome { is_cut: true, ..ProbeOutcome::default() };
        let ended = loop {
            match worker.wait()? {
                // It has ended none of its calls too late, but there were many.
                Event::Ended(Ended::TimedOut(time)) if time == limit => {
                    (outcome.timed_out, outcome.is_cut) = (true, false);
                    let (name, seconds) = (probe.name, limit.as_secs_f64());
                    let text = format!("the test {name} was ended after {seconds:.0} s");
                    let cause = text.clone();
                    outcome.found.push(ProbeFinding::new(rule!("not-tested"), text, cause));
                    return Ok(outcome);
                }
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
        let last = worker.record().snapshot();
        outcome.has_message = !last.message.is_empty();
        // What happens before the stage that a test is about is none of its business.
        let rule = match last.stage.is_empty() && !probe.is_misuse() {
            true => rule!("survives"),
            false => probe.crash(),
        };
        let mut crash = |rule, text: String, cause: String| {
            let found = ProbeFinding::new(rule, text, cause);
            outcome.found.push(ProbeFinding { is_crash: true, ..found });
        };
        let after = |how: &str| {
            format!("after its last call, the process {how}, expected it to end as usual")
        };
        if !ended.is_empty() && !outcome.is_cut {
            crash(rule, after(&ended), after(&ended));
            return Ok(outcome);
        }
        if !ended.is_empty() {
            let cause =
                format!("{} {}", called(&last), if outcome.timed_out { "hangs" } else { &ended });
            let text = unfinished(&last, &ended);
            /// A call that takes this part of the time limit may take all of it.
            const SLOW: f64 = 0.1;
            match outcome.timed_out && self.longest > SLOW * task.seconds as f64 {
                false => crash(rule, text, cause),
                true => {
                    let longest = self.longest;
                    let text = format!(
                        "{text}; it is slow, a step or the initialization has taken {longest:.1} s: --time-limit allows more"
                    );
                    crash(rule!("not-tested"), text, cause);
                }
            }
            let is_beside = probe.compares_instances() && !last.stage.is_empty();
            for found in outcome.found.iter_mut().filter(|found| found.is_crash) {
                found.is_shared_state = is_beside && found.rule.id != "not-tested";
            }
            return Ok(outcome);
        }
        if let Ended::Exited(status) = worker.end(GRACE)?
            && !status.success()
        {
            let text = after(&Ended::Exited(status).to_string());
            crash(rule, text.clone(), text);
        }
        if outcome.found.iter().any(|found| found.is_crash) {
            // The C library may have printed the reason.
            return Ok(outcome);
        }
        let mut head = Vec::new();
        File::open(printed)?.take(1000).read_to_end(&mut head)?;
        let head = String::from_utf8_lossy(&head);
        if let Some(line) = head.lines().find(|line| !line.trim().is_empty()) {
            let line = quote(line);
            let text = format!("the FMU printed {line}, expected that it logs by the callback");
            outcome.found.push(ProbeFinding::new(rule!("prints"), text, "prints".to_owned()));
        }
        Ok(outcome)
    }
}

/// The call that did not return.
fn called(last: &Snapshot) -> &'static str {
    match last.function {
        Some(Function::LOADING) => "loading it",
        function => function.and_then(Function::name).unwrap_or("the test"),
    }
}

/// Describes the call that did not return, given how the process ended.
fn unfinished(last: &Snapshot, ended: &str) -> String {
    let call = called(last);
    let stage = match last.stage.as_str() {
        stage if stage.is_empty() || stage.contains(call) => String::new(),
        stage => format!(", {stage},"),
    };
    let how = ended.replace(" and was killed", "");
    let when = last.time.map(|time| format!(" at t = {time} s"));
    let (when, logged) = (when.unwrap_or_default(), logged(&last.message));
    format!("{call}{stage} {how}{when}, expected it to return{logged}")
}
