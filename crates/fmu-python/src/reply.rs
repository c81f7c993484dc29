//! Replies of worker processes to Python.

use std::time::Instant;

use fmu_master::RunError;
use fmu_worker::{Event, Worker};
use pyo3::prelude::*;
use serde::de::DeserializeOwned;

use crate::error::to_exception;
use crate::run::PERIOD;

/// Waits for the reply of a worker, without Python's lock. Ctrl-C ends the worker. `names` returns the names of the
/// instances of the worker and of their files.
pub fn receive<T: DeserializeOwned>(
    worker: &mut Worker,
    names: impl FnOnce() -> Vec<(String, String)>,
) -> PyResult<T> {
    let mut looked = Instant::now();
    loop {
        match worker.poll()? {
            Some(Event::Replied) => return Ok(worker.reply()?),
            Some(Event::Ended(ended)) => {
                let crash = RunError::crash(worker, &names(), &ended.to_string());
                return Err(to_exception(*crash));
            }
            None if looked.elapsed() >= PERIOD => {
                looked = Instant::now();
                if let Err(raised) = Python::attach(|py| py.check_signals()) {
                    worker.kill()?;
                    return Err(raised);
                }
            }
            None => worker.pause(),
        }
    }
}
