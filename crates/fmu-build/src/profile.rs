//! The settings of the profile with which FMU binaries are built.

use std::fs;

use anyhow::{Context, Result};
use cargo_metadata::Metadata;

const RELEASE: &str = "release";

/// An FMU binary is small and fast, without the symbols of Rust. What a host calls at every step is
/// compiled with the model; the rest of its libraries is optimized for size.
const DEFAULTS: [(&str, &str); 7] = [
    ("lto", "\"fat\""),
    ("codegen-units", "1"),
    ("strip", "\"symbols\""),
    ("opt-level", "3"),
    ("package.fmu-export.opt-level", "\"s\""),
    ("package.fmu-description.opt-level", "\"s\""),
    ("package.postcard.opt-level", "\"s\""),
];

/// Arguments of cargo's option `--config` for a release: what the workspace does not set itself.
///
/// # Errors
/// The manifest of the workspace cannot be read.
pub fn settings(profile: &str, metadata: &Metadata) -> Result<Vec<String>> {
    if profile != RELEASE {
        return Ok(Vec::new());
    }
    let manifest = metadata.workspace_root.join("Cargo.toml");
    let cannot = || format!("cannot read {manifest}");
    let text = fs::read_to_string(&manifest).with_context(cannot)?;
    let table: toml::Table = text.parse().with_context(cannot)?;
    let profiles = table.get("profile");
    let own = profiles.and_then(|profiles| profiles.get(RELEASE));
    Ok(DEFAULTS
        .into_iter()
        .filter(|(key, _)| {
            let set = own.and_then(|own| key.split('.').try_fold(own, toml::Value::get));
            set.is_none()
        })
        .map(|(key, value)| format!("profile.{RELEASE}.{key}={value}"))
        .collect())
}
