//! What a worker process does for Python.

use std::path::PathBuf;

use anyhow::{Result, bail};
use fmu_master::single::{self, Setup};
use fmu_master::{Changes, Description, Interface, Order, Plan, Start, is_fmu, locate, run};
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
    let mut loaded = Loaded::default();
    loop {
        match service.task()? {
            None => return Ok(()),
            Some(Job::Run(system)) => run::work(service, true, || loaded.plan(system))?,
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
    pub fn plan(&mut self, system: System) -> Result<(&Plan, Vec<Start>)> {
        let is_same = |(last, plan): &(System, Plan)| {
            let System { file, text, changes, sets } = last;
            (file, text, changes) == (&system.file, &system.text, &system.changes)
                && plan.sizes(sets) == plan.sizes(&system.sets)
        };
        let plan = match self.0.take().filter(is_same) {
            Some((_, plan)) => plan,
            None => system.plan()?.0,
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
    changes: Changes,
    sets: Vec<(String, String)>,
}

impl System {
    /// Loads the FMUs.
    ///
    /// # Errors
    /// The system is invalid, or an FMU.
    pub fn plan(&self) -> Result<(Plan, Vec<Start>)> {
        let mut description = match &self.text {
            Some(text) => Description::parse(text, &self.file)?,
            None => Description::open(&self.file)?,
        };
        description.change(&self.changes);
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

impl TryFrom<Given> for System {
    type Error = anyhow::Error;

    fn try_from(given: Given) -> Result<Self> {
        let order = match given.order.as_deref() {
            None => None,
            Some("sequential") => Some(Order::Sequential),
            Some("parallel") => Some(Order::Parallel),
            Some(other) => bail!("order = {other:?}, expected \"sequential\" or \"parallel\""),
        };
        Ok(Self {
            file: given.file,
            text: given.text,
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
        })
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
