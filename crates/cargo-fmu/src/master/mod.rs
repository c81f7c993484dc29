//! What the native master does: `simulate`, `table1`, `sweep`, `ssp`.
//!
//! The options are always here, so that help and completions know them. The work needs the feature
//! `master`; without it, `forward` builds this program anew and hands the command on.

#[cfg(not(feature = "master"))]
pub mod forward;
pub mod simulate;
pub mod ssp;
pub mod sweep;
#[cfg(feature = "master")]
mod sweeping;
#[cfg(feature = "master")]
mod table;
pub mod table1;
