//! The host's side of the C interface: loads FMU binaries from any vendor and calls them.
//!
//! A [`Library`] is a loaded binary, whose functions are looked up once. An [`Instance`] has a method
//! for each function, named after it. Statuses are read as integers, a missing function is a
//! [`Failure`] when it is called, and log messages are formatted and passed to a callback per instance.
//!
//! A foreign binary may violate the standard: it may crash, hang or exit. Load untrusted binaries in a
//! separate process, as `cargo fmu validate` does.

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

pub use functions::Functions;
pub use instance::{Instance, State};
pub use library::{Instantiation, Kind, Library, LoadError, Treatment};
pub use logger::{Logged, stray_messages};
pub use model_exchange::{Completed, Update};
pub use outcome::{Cause, Failure, Result, Status, Success};
pub use resources::uri;
pub use shared_memory::SharedMemory;
