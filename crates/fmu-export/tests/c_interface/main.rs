//! All edges of the C interface as a host uses them, with models that have every kind of variable and fail on
//! demand. A case runs at each edge that has what it tests.
//!
//! The logger of these tests is not variadic, as Rust cannot define variadic functions. This works on
//! all CI platforms except macOS on ARM, which passes variadic arguments differently.
#![cfg(not(all(target_vendor = "apple", target_arch = "aarch64")))]
#![allow(non_upper_case_globals, reason = "the names of the standard")]

mod authors;
mod clocks;
mod driver;
mod events;
mod exchange;
mod fmu;
mod instances;
mod integration;
mod large;
mod log;
mod models;
mod ramps;
mod rates;
mod references;
mod samples;
mod saved;
mod scheduled;
mod single_instance;
mod sizes;
mod standard;
mod states;
mod steps;
mod updates;
mod values;
mod walk;
