//! The commands with their options and output.

pub mod compare;
pub mod completions;
pub mod export;
pub mod info;
pub mod merge;
pub mod new;
pub mod simulate;
pub mod ssp;
pub mod sweep;
pub mod try_out;
pub mod validate;
mod worker;
