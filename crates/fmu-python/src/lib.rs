//! The native part of the Python package `fmu_master`: runs of the master, and the command line. Python sees
//! numbers, texts and bytes; the package gives them their shape.
#![forbid(unsafe_code)]

mod columns;
mod job;
mod run;
mod single;
mod words;

use pyo3::prelude::*;

/// The native part of `fmu_master`.
#[pymodule]
mod _native {
    use std::ffi::OsString;
    use std::process::ExitCode;

    use fmu_worker::Service;
    use pyo3::exceptions::PyRuntimeError;
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::run::{Runner, bounds, compare, points, read, times};

    #[pymodule_export]
    use super::single::Instance;

    use super::job;

    /// Runs the command line, and ends the process. `program` starts it again.
    #[pyfunction]
    fn main(py: Python<'_>, program: Vec<OsString>, arguments: Vec<OsString>) {
        let code = py.detach(|| cargo_fmu::main(program, arguments.into_iter()));
        let number = (0..u8::MAX).find(|number| ExitCode::from(*number) == code);
        std::process::exit(number.unwrap_or(u8::MAX).into())
    }

    /// Does the job for which another process has started this one.
    #[pyfunction]
    fn work(py: Python<'_>) -> PyResult<()> {
        py.detach(|| {
            let service = Service::from_env()?;
            let mut service = service.ok_or_else(|| std::io::Error::other("not a worker"))?;
            job::work(&mut service)
        })
        .map_err(|error| PyRuntimeError::new_err(format!("{error:#}")))
    }
}
