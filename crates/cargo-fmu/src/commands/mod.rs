//! The commands with their options and output.

#[cfg(feature = "run")]
pub mod compare;
pub mod completions;
pub mod export;
pub mod info;
pub mod merge;
pub mod new;
#[cfg(feature = "run")]
pub mod run;
#[cfg(feature = "run")]
pub mod simulate;
#[cfg(feature = "run")]
pub mod ssp;
#[cfg(feature = "run")]
pub mod sweep;
#[cfg(feature = "run")]
pub mod try_out;
#[cfg(feature = "run")]
pub mod validate;
#[cfg(feature = "run")]
mod worker;
