//! The C types of the Functional Mock-up Interface, for both sides of it: FMU binaries and the hosts
//! that load them.
#![no_std]
#![forbid(unsafe_code)]

pub mod fmi2;
