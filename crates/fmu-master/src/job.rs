//! Jobs: typed data that the supervisor side makes and sends to a worker process, and the function of the worker side that
//! does them.

use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Result;
use fmu_description::Value;
use fmu_worker::{Limits, Service, Worker};
use serde::{Deserialize, Serialize};

use crate::function::Computed;
use crate::run::{self, Report};
use crate::stepped_fmu::{self, Setup};
use crate::sweep::{self, SweepSource};
use crate::trace::{self, ReplaySource};
use crate::vector::{self, ShareSource};
use crate::{
    Description, Observation, Overrides, Plan, Signature, StartValue, is_fmu, locate, table,
};

/// The job of a worker process.
#[derive(Debug, Serialize, Deserialize)]
pub enum Job {
    /// One run of a system.
    Run {
        /// The system.
        system: SystemSource,
        /// Whether the supervisor needs the rows.
        records: bool,
    },
    /// Runs of a sweep, whose numbers follow.
    Sweep(SweepSource),
    /// An FMU that is stepped by hand: its requests follow.
    Step(Setup),
    /// The calls of a trace.
    Replay(ReplaySource),
    /// Instances of an FMU that are stepped together: their tasks follow.
    Vector(ShareSource),
}

/// Supervisor side: starts a worker process by a command that calls [`serve`], and sends it a job. `session` is a
/// temporary folder.
///
/// # Errors
/// The process cannot be started.
pub fn start(
    command: &mut Command,
    session: &Path,
    limits: Limits,
    job: &Job,
) -> io::Result<Worker> {
    let input = match job {
        Job::Run { system, .. } if system.reads_standard_input() => Stdio::inherit(),
        _ => Stdio::null(),
    };
    let mut worker = Worker::start_with_input(command, input, session, limits)?;
    worker.send(job);
    Ok(worker)
}

/// Worker side: does the jobs of the supervisor, until there are no more.
///
/// # Errors
/// A job is damaged, or the files of a sweep have changed.
pub fn serve(service: &mut Service) -> Result<()> {
    let compute = run::compute_in_supervisor(service, Report::Call)?;
    let mut loaded = LoadedSystem::default();
    while let Some(job) = service.task()? {
        match job {
            Job::Run { system, records } => {
                let observation = system.overrides.observation.clone();
                let how = (records, &observation);
                run::serve(service, how, |warn| loaded.plan(system, &compute, warn))?;
            }
            Job::Sweep(source) => return sweep::serve(service, &source),
            Job::Step(setup) => return stepped_fmu::serve(service, &setup),
            Job::Replay(source) => return trace::serve(service, &source),
            Job::Vector(share) => return vector::serve(service, &share),
        }
    }
    Ok(())
}

/// The system of a run: a file, or the text of a system file, and what replaces its parts.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SystemSource {
    /// An FMU, a system file or an SSP package. Paths in a text are relative to the folder of this file.
    pub file: PathBuf,
    /// The text of a system file that is not on the disk.
    pub text: Option<String>,
    /// The components that are functions.
    pub functions: Vec<(String, Signature)>,
    /// The changes.
    pub overrides: Overrides,
}

impl SystemSource {
    /// Whether the inputs come from the standard input of the worker.
    fn reads_standard_input(&self) -> bool {
        self.overrides.input.as_deref().is_some_and(table::is_standard_input)
    }

    /// Loads the FMUs, and resolves the start values of the run. `compute` computes the outputs of a function, by its
    /// number, at a time (s); `warn` receives warnings about an SSP package.
    ///
    /// # Errors
    /// The system is invalid, or an FMU.
    pub fn plan(
        &self,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
        warn: &mut dyn FnMut(&str),
    ) -> Result<(Plan, Vec<StartValue>)> {
        let plan = self.load(compute, warn)?;
        let starts = plan.start_values(&self.overrides.sets)?;
        Ok((plan, starts))
    }

    fn load(
        &self,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
        warn: &mut dyn FnMut(&str),
    ) -> Result<Plan> {
        let mut description = match &self.text {
            Some(text) => Description::parse_unsaved(text, &self.file)?,
            None => Description::open(&self.file)?,
        };
        self.overrides.apply(&mut description)?;
        let packages = description.package.iter();
        packages.flat_map(|package| &package.warnings).for_each(|text| warn(text));
        description.set_functions(&self.functions, compute)?;
        let plan = Plan::new(&description).map_err(|error| self.locate(error))?;
        plan.resized(description, &self.overrides.sets)
    }

    /// Adds the system file to an error, and the line unless the value may come from an override.
    fn locate(&self, error: anyhow::Error) -> anyhow::Error {
        if self.text.is_some() || is_fmu(&self.file) {
            return error;
        }
        let Overrides { start, stop, step, .. } = self.overrides;
        let text = match start.or(stop).or(step) {
            None => std::fs::read_to_string(&self.file).unwrap_or_default(),
            Some(_) => String::new(),
        };
        locate(error, &self.file, &text)
    }
}

/// The system that was run last, with its FMUs.
#[derive(Default)]
pub struct LoadedSystem(Option<(SystemSource, Plan)>);

impl LoadedSystem {
    /// The plan of a system and its start values. The FMUs stay loaded while only the start values change, or what is
    /// observed.
    ///
    /// # Errors
    /// As [`SystemSource::plan`].
    pub fn plan(
        &mut self,
        mut system: SystemSource,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
        warn: &mut dyn FnMut(&str),
    ) -> Result<(&Plan, Vec<StartValue>)> {
        let starts = std::mem::take(&mut system.overrides.sets);
        system.overrides.observation = Observation::default();
        let last = self.0.take().and_then(|(mut last, plan)| {
            let last_starts = std::mem::take(&mut last.overrides.sets);
            // The file of a saved state may have changed.
            let is_same = last == system
                && plan.live.is_none()
                && system.overrides.load_state.is_none()
                && plan.sizes(&last_starts) == plan.sizes(&starts);
            is_same.then_some(plan)
        });
        system.overrides.sets = starts;
        let plan = match last {
            Some(plan) => plan,
            None => system.load(compute, warn)?,
        };
        let (system, plan) = self.0.insert((system, plan));
        Ok((plan, plan.start_values(&system.overrides.sets)?))
    }
}
