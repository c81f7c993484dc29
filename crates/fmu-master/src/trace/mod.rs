//! Traces: files with each call of the FMUs of a run, in the order in which they happen.
//!
//! A trace is JSON Lines; `docs/traces.md` describes the format. The line of a call is begun before the call and completed
//! after it, so that the file of a run whose FMU crashes ends with the call in which it does.

mod element;
mod print;
mod program;
mod read;
mod recorder;
mod replay;

pub use print::print_calls;
pub use program::write_program;
pub use read::{Trace, TracedCall, TracedComponent};
pub(crate) use recorder::Recorder;
pub use recorder::close;
pub use replay::{Difference, ReplayEnd, ReplaySource, Replayed, serve, supervise};

/// The version of the format.
pub const VERSION: u64 = 1;
