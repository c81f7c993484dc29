//! The host's side of the C interface: loads FMU binaries from any vendor and calls them.
//!
//! A [`Library`] is a loaded binary, whose functions are looked up once. An [`Instance`] is one of FMI 2.0
//! or of 3.0, and has a method for each function; functions that do the same in both versions are one
//! method. A call of a function that the version of the instance does not have is a [`Failure`]. Statuses are read as integers, a missing function is a
//! [`Failure`] when it is called, and log messages are formatted and passed to a callback per instance.
//!
//! A foreign binary may violate the standard: it may crash, hang or exit. Load untrusted binaries in a
//! separate process, as `cargo fmu validate` does.

mod access;
mod co_simulation;
pub mod environment;
mod functions;
mod instance;
mod library;
mod logger;
mod model_exchange;
mod outcome;
mod resources;
mod shared_memory;
mod trampoline;

pub use access::Dependency;
pub use co_simulation::Stepped;
pub use functions::{Functions, Functions3};
pub use instance::{Instance, State};
pub use library::{Instantiation, Kind, Library, LoadError, Options, Treatment};
pub use logger::{Intermediate, Logged, OnIntermediate, stray_messages};
pub use model_exchange::{Completed, Update};
pub use outcome::{Cause, Failure, Result, Status, Success, Version};
pub use resources::{resource_path, uri};
pub use shared_memory::SharedMemory;
