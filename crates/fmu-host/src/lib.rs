//! The other side of the C interface: calls the FMU binaries of any maker, as an importer does.
//!
//! Nobody can know that a foreign binary keeps to the standard. Load one only in a process that may
//! crash, hang or exit: `cargo fmu validate` starts one for it.

mod co_simulation;
mod instance;
mod library;
mod model_exchange;

use std::ffi::c_int;
use std::fmt;

pub use instance::{Instance, State};
pub use library::Library;

/// The two kinds of FMU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// The host integrates.
    ModelExchange,
    /// The FMU integrates.
    CoSimulation,
}

/// Why a call did not do what it is for.
#[derive(Debug)]
pub struct Failure(String);

impl Failure {
    fn new(function: &str, what: impl fmt::Display) -> Self {
        Self(format!("{function} {what}"))
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Failure {}

/// What a call gives that can fail.
pub type Result<T> = std::result::Result<T, Failure>;

/// Reads a status: fmi2OK and fmi2Warning mean success. It is an integer here, since a foreign binary
/// may give any.
fn check(function: &str, status: c_int) -> Result<()> {
    let name = match status {
        0 | 1 => return Ok(()),
        2 => "fmi2Discard",
        3 => "fmi2Error",
        4 => "fmi2Fatal",
        5 => "fmi2Pending",
        other => {
            return Err(Failure::new(
                function,
                format_args!("gave {other}, expected a fmi2Status"),
            ));
        }
    };
    Err(Failure::new(
        function,
        format_args!("gave {name}, expected fmi2OK"),
    ))
}
