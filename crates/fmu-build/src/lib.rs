//! Builds the models of a cargo workspace into FMUs: finds the models, generates their descriptions and
//! documentation, builds a shared library for each platform, and packs the archives.
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
