//! The native part of the Python package `fmu_master`: runs of the master, and the command line. Python sees
//! numbers, texts and bytes; the package gives them their shape.
#![forbid(unsafe_code)]

mod arguments;
mod caller;
mod child;
mod error;
mod instance;
mod pack;
mod reply;
mod run;
mod sweep;
mod tables;
mod values;
mod vector;
mod words;

use pyo3::prelude::*;

/// The native part of `fmu_master`.
#[pymodule]
mod _native {
    use std::ffi::OsString;
    use std::process::ExitCode;

    use pyo3::prelude::*;

    #[pymodule_export]
    use super::run::{Runner, bounds, points, times};

    #[pymodule_export]
    use super::tables::{compare, read, set_points, write};

    #[pymodule_export]
    use super::instance::Instance;

    #[pymodule_export]
    use super::pack::pack;

    #[pymodule_export]
    use super::sweep::sweep;

    #[pymodule_export]
    use super::vector::Vector;

    /// Runs the command line, and ends the process. `program` starts it again.
    #[pyfunction]
    fn main(py: Python<'_>, program: Vec<OsString>, arguments: Vec<OsString>) {
        let code = py.detach(|| cargo_fmu::main(program, arguments.into_iter()));
        let number = (0..u8::MAX).find(|number| ExitCode::from(*number) == code);
        std::process::exit(number.unwrap_or(u8::MAX).into())
    }
}
