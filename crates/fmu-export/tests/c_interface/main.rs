//! The C interface as a host uses it, on models with every kind of variable that fail on demand.
//!
//! The logger of these tests is not variadic, as Rust cannot define such a function. That works on all
//! platforms of CI, but not on macOS on ARM, where variadic arguments are passed differently.
#![cfg(not(all(target_vendor = "apple", target_arch = "aarch64")))]

mod arguments;
mod damage;
mod derivatives;
mod experiment;
mod fmu_state;
mod host;
mod instances;
mod logging;
mod models;
mod reals;
mod sequences;
mod state_machine;
