//! The host's side of the C interface: loads FMU binaries from any vendor and calls them.
//!
//! A [`Library`] is an FMU binary of one version of FMI, whose functions are looked up once. An [`Instance`]
//! has a method for each operation of FMI, named as in FMI 3.0, which calls the function of its version. A
//! call of a function that the version does not have, or the binary, is a [`Failure`]. Statuses are read as
//! integers, and log messages are formatted and passed to a callback per instance.
//!
//! With the feature `sandbox`, a library can also be a WebAssembly component, which wasmtime runs.
//!
//! A foreign binary may violate the standard: it may crash, hang or exit. Load untrusted binaries in a
//! separate process, as `cargo fmu validate` does.

mod access;
mod clocks;
mod crash;
pub mod environment;
mod fork;
mod function_instance;
mod functions;
mod instance;
mod library;
mod logger;
mod observed;
mod outcome;
mod preemption;
mod quick;
pub mod real_time;
mod repeat;
mod resources;
#[cfg(feature = "sandbox")]
mod sandbox;
mod shared_memory;
mod step;
mod types;

pub use access::operation;
pub use clocks::{ClockUpdateMode, IntervalFraction, IntervalQualifier};
pub use crash::tell_crashes;
pub use fmi_abi::{FmiVersion, InterfaceType, fmi2, fmi3};
pub use fork::{ProcessOwned, this_process};
pub use function_instance::StepFunction;
pub use instance::{Instance, Number, allocations};
pub use library::{Library, LoadError};
pub use logger::{LogMessage, OnIntermediate, stray_messages};
pub use observed::{CallObserver, Direction, Element, ObservedCall};
pub use outcome::{Cause, Failure, Result, Status, Success};
pub use quick::{NotOk, StepVariables};
pub use repeat::{RepeatedCall, RepeatedStates};
pub use resources::{resource_path, uri};
pub use shared_memory::SharedMemory;
pub use types::{
    CompletedStep, DiscreteStatesUpdate, FmuState, Instantiation, Limits, StepResult, Treatment,
};
