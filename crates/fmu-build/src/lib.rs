//! Builds the models of a cargo workspace into FMUs: finds and describes them, builds a shared library
//! for each platform, writes documentation, and packs it all.
#![forbid(unsafe_code)]

mod binary;
mod build;
mod documentation;
mod export;
mod library;
mod macho;
pub mod table;
mod toolchain;

pub use fmu_file::archive::Compression;

pub use export::{Options, Written, export};
