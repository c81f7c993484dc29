//! The controllers of the paper as FMUs: one binary for all, told apart by their GUIDs.
//!
//! A new controller is one file beside these, with a struct, a table and a step, and its name in the
//! two lists below.
#![forbid(unsafe_code)]

mod ipid_rbf;
mod pid;
mod pid_rbf;
mod rows;

pub use ipid_rbf::IpidRbf;
pub use pid::Pid;
pub use pid_rbf::PidRbf;

fmu_export::export!(Pid, PidRbf, IpidRbf);
