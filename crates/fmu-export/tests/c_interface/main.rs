//! The C interface as a host uses it, with models that have a variable of every kind and fail on
//! demand.
//!
//! The logger of these tests stands for a function of C with a variable number of arguments, which
//! macOS on ARM calls in another way.
#![cfg(not(all(target_vendor = "apple", target_arch = "aarch64")))]

mod arguments;
mod damage;
mod derivatives;
mod experiment;
mod host;
mod lives;
mod logging;
mod models;
mod reals;
mod sequences;
mod state_machine;
mod states;
