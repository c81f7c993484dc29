//! Worker side: the one entry of all worker processes. `simulate`, `run`, `sweep`, `validate` and the Python module start
//! this program again with the hidden command `__worker`, and send it what to do.

use anyhow::{Context, Result};
use clap::ValueEnum;
use fmu_master::job;
use fmu_worker::Service;

/// The name of the command.
pub const COMMAND: &str = "__worker";

/// Who has started the worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Supervisor {
    /// The master, which sends a [`Job`](job::Job).
    Master,
    /// The validator, which sends one test of a binary.
    Validator,
}

/// Does what the supervisor sends, until there is no more.
///
/// # Errors
/// The process was not started by a supervisor, or what it was sent cannot be done.
pub fn main(supervisor: Supervisor) -> Result<()> {
    match supervisor {
        Supervisor::Validator => fmu_check::probe(),
        Supervisor::Master => {
            let service = Service::from_env()?;
            job::serve(&mut service.context("it is started by other commands only")?)
        }
    }
}
