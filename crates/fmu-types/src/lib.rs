//! The C types of the Functional Mock-up Interface (FMI), for FMU binaries and for the hosts that load
//! them.
#![no_std]
#![forbid(unsafe_code)]

pub mod fmi2;
pub mod fmi3;
