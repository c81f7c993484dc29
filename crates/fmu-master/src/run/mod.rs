//! One run of a system. A supervisor starts a worker process, which makes the plan of the run and steps it; the
//! supervisor receives each row and writes it to a file.

mod completed;
mod report;
mod rows;
mod supervisor;
mod worker;

pub use completed::{Completed, simulate};
pub use report::Ready;
pub(crate) use report::Report;
pub use supervisor::{RunOutcome, SupervisedRun, Watch, supervise};
pub(crate) use worker::{compute_in_supervisor, serve};
