//! The C interface of FMI 3.0.

mod access;
mod events;
mod exchange;
pub mod host;
mod instances;
mod intermediate;
mod sequences;
mod state_machine;
mod states;
mod steps;
