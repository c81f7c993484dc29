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
    match service.task()? {
        None => Ok(()),
        Some(Job::Run(system)) => run::work(service, true, || system.plan()),
        Some(Job::Single(setup)) => single::work(service, &setup),
    }
}

/// The system of a run: a file, or the text of a system file.
#[derive(Serialize, Deserialize)]
pub struct System {
    file: PathBuf,
    text: Option<String>,
    changes: Changes,
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
        plan?.set(description, &self.changes.sets)
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
                sets: given.sets,
                ..Changes::default()
            },
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
