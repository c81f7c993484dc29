//! The controllers of the paper as FMUs. They share one binary; the GUID selects the controller.
//!
//! To add a controller, add a module with a struct and a step function, and list it below.
#![forbid(unsafe_code)]

mod ipid_rbf;
mod pid;
mod pid_rbf;
mod signals;

pub use ipid_rbf::IpidRbf;
pub use pid::Pid;
pub use pid_rbf::PidRbf;

fmu_export::export!(Pid, PidRbf, IpidRbf);
