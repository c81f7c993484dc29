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
mod without_wasm;

use anyhow::Result;

use crate::library::NamedFile;

#[cfg(feature = "wasm")]
pub use translation::build;
#[cfg(not(feature = "wasm"))]
pub use without_wasm::build;

/// Builds the library of a model with arguments for the compiler and a size of the heap.
pub type BuildLibrary<'a> = dyn Fn(&[String], u64) -> Result<Vec<u8>> + 'a;

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
