//! The binary of container FMUs, which `cargo fmu pack` makes: the functions of FMI 2.0 and 3.0 for co-simulation, by
//! which a host runs the system of FMUs in the resources.
//!
//! The functions are made of the rows of [`fmi_abi`]. An entry converts its arguments, checks the state, and calls the
//! method of `Instance` with the name of the row's operation; [`fmu_master::container`] has what the
//! methods do.
#![allow(
    non_snake_case,
    non_upper_case_globals,
    clippy::missing_safety_doc,
    clippy::too_many_arguments,
    reason = "names, arguments and safety requirements are defined by the standard"
)]

#[macro_use]
mod entry;
pub mod fmi2;
pub mod fmi3;
mod host_log;
mod instance;
mod pointers;
