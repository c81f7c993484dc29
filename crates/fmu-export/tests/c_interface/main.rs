//! The C interface as a host uses it, with models that have every kind of variable and fail on demand.
//!
//! The logger of these tests is not variadic, as Rust cannot define variadic functions. This works on
//! all CI platforms except macOS on ARM, which passes variadic arguments differently.
#![cfg(not(all(target_vendor = "apple", target_arch = "aarch64")))]
#![allow(non_upper_case_globals, reason = "the names of the standard")]

mod arguments;
mod damage;
mod derivatives;
mod exchange;
mod experiment;
mod fmi3;
mod fmu_state;
mod host;
mod instances;
mod integration;
mod layer;
mod logging;
mod models;
mod reals;
mod resources;
mod sampling;
mod sequences;
mod state_machine;
mod types;
mod variant;
