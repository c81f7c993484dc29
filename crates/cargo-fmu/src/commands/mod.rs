//! The commands with their options and output.

pub mod build;
pub mod compare;
pub mod completions;
pub mod diff;
pub mod export;
mod files;
pub mod info;
mod limits;
pub mod merge;
pub mod new;
mod over;
pub mod pack;
pub mod replay;
pub mod run;
pub mod simulate;
pub mod ssp;
pub mod stale;
pub mod sweep;
pub mod validate;
