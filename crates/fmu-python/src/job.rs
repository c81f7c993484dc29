//! What a worker process does for Python.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use fmu_description::Value;
use fmu_master::run::Computed;
use fmu_master::stepped_fmu::{self, Setup};
use fmu_master::{
    Description, Function, Overrides, Plan, Signature, StartValue, is_fmu, locate, run,
};
use fmu_worker::Service;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// The task of a worker process.
#[derive(Serialize, Deserialize)]
pub enum Job {
    /// A run.
    Run(System),
    /// An FMU that is stepped by hand.
    Step(Setup),
}

/// Does the job that another process sends.
///
/// # Errors
/// The job is damaged.
pub fn work(service: &mut Service) -> Result<()> {
    let compute = run::compute_in_supervisor(service)?;
    let mut loaded = Loaded::default();
    loop {
        match service.task()? {
            None => return Ok(()),
            Some(Job::Run(system)) => {
                run::work(service, true, || loaded.plan(system, &compute))?;
            }
            Some(Job::Step(setup)) => return stepped_fmu::serve(service, &setup),
        }
    }
}

/// The system that was run last, with its FMUs.
#[derive(Default)]
pub struct Loaded(Option<(System, Plan)>);

impl Loaded {
    /// The plan of a system and its start values. The FMUs stay loaded while only the start values change.
    ///
    /// # Errors
    /// As [`System::plan`].
    pub fn plan(
        &mut self,
        system: System,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
    ) -> Result<(&Plan, Vec<StartValue>)> {
        let is_same = |(last, plan): &(System, Plan)| {
            let System { file, text, functions, changes, sets } = last;
            (file, text, functions, changes)
                == (&system.file, &system.text, &system.functions, &system.changes)
                && plan.sizes(sets) == plan.sizes(&system.sets)
        };
        let plan = match self.0.take().filter(is_same) {
            Some((_, plan)) => plan,
            None => system.plan(compute)?.0,
        };
        let (system, plan) = self.0.insert((system, plan));
        Ok((plan, plan.start_values(&system.sets)?))
    }
}

/// The system of a run: a file, or the text of a system file.
#[derive(Serialize, Deserialize)]
pub struct System {
    file: PathBuf,
    text: Option<String>,
    /// The components that are functions.
    functions: Vec<(String, Signature)>,
    changes: Overrides,
    sets: Vec<(String, String)>,
}

/// What Python passes, as TOML.
///
/// # Errors
/// A word is unknown, or a value has a wrong type.
pub fn given<T: DeserializeOwned>(text: &str) -> Result<T> {
    toml::from_str(text).map_err(|error| {
        let span = error.span().unwrap_or_default();
        let key = text[..span.start].rfind(['{', ',', '\n']).map_or(0, |before| before + 1);
        anyhow!("{}: {}", text[key..span.end].trim(), error.message())
    })
}

impl System {
    /// Loads the FMUs. `compute` computes the outputs of a function, by its number, at a time (s).
    ///
    /// # Errors
    /// The system is invalid, or an FMU.
    pub fn plan(
        &self,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
    ) -> Result<(Plan, Vec<StartValue>)> {
        let mut description = match &self.text {
            // Its lines are not the user's.
            Some(text) => Description::parse(text, &self.file).map_err(|error| {
                let text = error.to_string();
                anyhow!("{}", text.rsplit_once("^\n").map_or(&*text, |(_, reason)| reason))
            })?,
            None => Description::open(&self.file)?,
        };
        self.changes.apply(&mut description);
        for (number, (name, signature)) in self.functions.iter().enumerate() {
            let compute = compute.clone();
            let compute = move |time, inputs: &[Value]| compute(number, time, inputs);
            let function = Function { signature: signature.clone(), compute: Arc::new(compute) };
            let mut components = description.components.iter_mut();
            let component = components.find(|component| component.name == *name);
            component.with_context(|| format!("there is no component {name}"))?.function =
                Some(function);
        }
        let plan = match (Plan::new(&description), &self.text) {
            (Err(error), None) if !is_fmu(&self.file) => Err(locate(error, &self.file, "")),
            (plan, _) => plan,
        };
        plan?.set(description, &self.sets)
    }
}
