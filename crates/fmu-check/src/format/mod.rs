//! Findings for other programs.

mod json;
mod sarif;

pub use json::json;
pub use sarif::sarif;

/// The name of the program that other programs show.
const TOOL: &str = "cargo-fmu";
