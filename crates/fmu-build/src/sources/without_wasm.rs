//! What stands in for the translation in builds without the feature `wasm`.

use std::path::Path;

use anyhow::{Result, bail};

use super::{BuildLibrary, Sources};
use crate::model::BuiltModel;

/// Fails.
pub fn build(_: &BuiltModel<'_>, _: u64, _: &Path, _: &BuildLibrary<'_>) -> Result<Sources> {
    bail!("this program was built without its feature `wasm`, which --sources needs")
}
