//! The commands with their options and output.

pub mod completions;
pub mod export;
pub mod info;
pub mod merge;
pub mod new;
pub mod probe;
pub mod simulate;
pub mod ssp;
pub mod sweep;
pub mod validate;
mod worker;
