//! Builds the models of a cargo workspace into FMUs: builds a shared library for each platform, reads
//! the interfaces of the models in it, generates their descriptions and documentation, and packs the
//! archives.
#![forbid(unsafe_code)]

mod binary;
mod cargo;
#[cfg(feature = "wasm")]
mod component;
mod container;
mod contents;
pub mod dependency;
mod export;
mod exports;
mod guid;
mod library;
mod missing;
mod model;
mod page;
mod references;
mod sources;
pub mod table;
mod toolchain;
mod triple;
mod universal;

pub use fmu_description::FmiVersion;

pub use cargo::BuildProgress;
pub use container::{ContainerBinary, ContainerTargets, container_page};
pub use export::{ExportOptions, ExportedFmu, SourcesOption, export, version};
pub use exports::{export_command, stale};
pub use guid::GuidBasis;
pub use library::Selection;
pub use model::Variant;
