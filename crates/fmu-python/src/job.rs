//! What a worker process does for Python.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use fmu_description::Value;
use fmu_master::run::Computed;
use fmu_master::single::{self, Setup};
use fmu_master::{
    Argument, Changes, Description, Function, Interface, Order, Plan, Signature, Start, is_fmu,
    locate, run,
};
use fmu_worker::Service;
use pyo3::prelude::*;
use serde::{Deserialize, Serialize};

/// The task of a worker process.
#[derive(Serialize, Deserialize)]
pub enum Job {
    /// A run.
    Run(System),
    /// An FMU that is stepped by hand.
    Single(Setup),
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
            Some(Job::Single(setup)) => return single::work(service, &setup),
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
    ) -> Result<(&Plan, Vec<Start>)> {
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
        Ok((plan, plan.texts(&system.sets)?))
    }
}

/// The system of a run: a file, or the text of a system file.
#[derive(Serialize, Deserialize)]
pub struct System {
    file: PathBuf,
    text: Option<String>,
    /// The components that are functions.
    functions: Vec<(String, Signature)>,
    changes: Changes,
    sets: Vec<(String, String)>,
}

impl System {
    /// Loads the FMUs. `compute` computes the outputs of a function, by its number, at a time (s).
    ///
    /// # Errors
    /// The system is invalid, or an FMU.
    pub fn plan(
        &self,
        compute: &(impl Fn(usize, f64, &[Value]) -> Computed + Clone + Send + Sync + 'static),
    ) -> Result<(Plan, Vec<Start>)> {
        let mut description = match &self.text {
            // Its lines are not the user's.
            Some(text) => Description::parse(text, &self.file).map_err(|error| {
                let text = error.to_string();
                anyhow!("{}", text.rsplit_once("^\n").map_or(&*text, |(_, reason)| reason))
            })?,
            None => Description::open(&self.file)?,
        };
        description.change(&self.changes);
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

/// The system as Python passes it.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Given {
    file: PathBuf,
    text: Option<String>,
    functions: Vec<Declared>,
    start: Option<f64>,
    stop: Option<f64>,
    step: Option<f64>,
    order: Option<String>,
    tolerance: Option<f64>,
    outputs: Vec<String>,
    input: Option<PathBuf>,
    interface: Option<String>,
    sets: Vec<(String, String)>,
}

/// A component that is a function, as Python passes it: with the names, types and units of its variables.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Declared {
    name: String,
    inputs: Vec<(String, String, String)>,
    outputs: Vec<(String, String, String)>,
    sample_time: Option<f64>,
    step: Py<PyAny>,
}

impl System {
    /// The system, and what its functions call.
    ///
    /// # Errors
    /// A word is unknown.
    pub fn new(given: Given) -> Result<(Self, Vec<Py<PyAny>>)> {
        let arguments = |all: Vec<(String, String, String)>| {
            let all = all.into_iter();
            all.map(|(name, of_type, unit)| Argument { name, of_type, unit }).collect()
        };
        let functions = given.functions.into_iter().map(|declared| {
            let Declared { name, inputs, outputs, sample_time, step } = declared;
            let (inputs, outputs) = (arguments(inputs), arguments(outputs));
            ((name, Signature { inputs, outputs, sample_time }), step)
        });
        let (functions, steps) = functions.unzip();
        let order = match given.order.as_deref() {
            None => None,
            Some("sequential") => Some(Order::Sequential),
            Some("parallel") => Some(Order::Parallel),
            Some(other) => bail!("order = {other:?}, expected \"sequential\" or \"parallel\""),
        };
        let system = Self {
            file: given.file,
            text: given.text,
            functions,
            changes: Changes {
                start: given.start,
                stop: given.stop,
                step: given.step,
                order,
                tolerance: given.tolerance,
                outputs: given.outputs,
                input: given.input,
                interface: given.interface.as_deref().map(interface).transpose()?,
                ..Changes::default()
            },
            sets: given.sets,
        };
        Ok((system, steps))
    }
}

/// An interface by its name.
///
/// # Errors
/// There is no such interface.
pub fn interface(name: &str) -> Result<Interface> {
    match name {
        "co-simulation" => Ok(Interface::CoSimulation),
        "model-exchange" => Ok(Interface::ModelExchange),
        _ => bail!("interface = {name:?}, expected \"co-simulation\" or \"model-exchange\""),
    }
}
