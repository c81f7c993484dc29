//! Methods for ordinary differential equations: their tables, and with the feature `solver` the integration of systems
//! with events.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "solver")]
extern crate alloc;
#[cfg(test)]
extern crate std;

pub mod dormand_prince;
pub mod rodas5p;
#[cfg(feature = "solver")]
pub mod solver;
