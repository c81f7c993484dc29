//! FMUs as C sources: the library of a model as a module of WebAssembly, translated to C, and the functions of the
//! standard, which call it.

#[cfg(feature = "wasm")]
mod build_description;
#[cfg(feature = "wasm")]
mod interface;
#[cfg(feature = "wasm")]
mod needs;
#[cfg(feature = "wasm")]
mod translation;
#[cfg(feature = "wasm")]
mod untranslatable;

#[cfg(not(feature = "wasm"))]
use std::path::Path;

#[cfg(not(feature = "wasm"))]
use anyhow::{Result, bail};

use crate::library::NamedFile;
#[cfg(not(feature = "wasm"))]
use crate::model::BuiltModel;

#[cfg(feature = "wasm")]
pub use translation::build;

/// Stands in for the translation in builds without the feature `wasm`.
#[cfg(not(feature = "wasm"))]
pub fn build(
    _: &BuiltModel<'_>,
    _: u64,
    _: &Path,
    _: &dyn Fn(&[String], u64) -> Result<Vec<u8>>,
) -> Result<Sources> {
    bail!("this program was built without its feature `wasm`, which --sources needs")
}

/// The C sources of a model.
#[derive(Debug)]
pub struct Sources {
    /// The names of the files to compile.
    pub compiled: Vec<String>,
    /// All files with their paths in the FMU.
    pub files: Vec<NamedFile>,
    /// What an instance needs.
    pub memory: Memory,
}

/// The memory of the model in an instance (bytes).
#[derive(Debug, Clone, Copy)]
pub struct Memory {
    /// All of it.
    pub total: u64,
    /// The stack in it.
    pub stack: u64,
}
