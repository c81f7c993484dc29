//! The shared libraries of models: builds or reads, checks and compresses them.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use cargo_metadata::Metadata;
use fmu_description::guid::checksum;
use fmu_file::archive::{Compression, Packed};
use fmu_file::platform::{Platform, Prebuilt};
use fmu_file::replace;

use crate::library::{Library, Model};
use crate::macho;
use crate::toolchain::{Recipe, Target};

/// A shared library for one or more platforms.
pub struct Binary {
    platforms: Vec<Platform>,
    bytes: Vec<u8>,
}

/// A compressed shared library.
pub struct PackedBinary {
    /// Its platforms.
    pub platforms: Vec<Platform>,
    /// Its content.
    pub file: Packed,
}

impl Binary {
    /// Builds a library for a target.
    ///
    /// # Errors
    /// The diagnostics of the compiler.
    pub fn build(library: &Library, target: &Target, metadata: &Metadata) -> Result<Self> {
        let mut parts = target
            .recipes
            .iter()
            .map(|recipe| build(library, recipe, target.platforms[0].extension, metadata))
            .collect::<Result<Vec<_>>>()?;
        let bytes = match parts.len() {
            1 => parts.remove(0),
            _ => macho::join(&parts).context("cannot join the parts of a universal binary")?,
        };
        Ok(Self {
            platforms: target.platforms.clone(),
            bytes,
        })
    }

    /// Reads a prebuilt binary.
    ///
    /// # Errors
    /// The file cannot be read or has another platform's format.
    pub fn read(prebuilt: &Prebuilt) -> Result<Self> {
        let file = prebuilt.file.display();
        let bytes = fs::read(&prebuilt.file).with_context(|| format!("cannot read {file}"))?;
        prebuilt
            .platform
            .check(&bytes)
            .with_context(|| format!("{file} cannot be used"))?;
        Ok(Self {
            platforms: vec![prebuilt.platform],
            bytes,
        })
    }

    /// Checks that the binary contains a model by searching for its GUID, which is stored as text.
    ///
    /// # Errors
    /// The GUID is missing.
    pub fn check_guid(&self, model: &Model<'_>) -> Result<()> {
        let guid = model.guid.as_bytes();
        ensure!(
            self.bytes.windows(guid.len()).any(|window| window == guid),
            "it does not contain the model {} with the GUID {}; was it built from another version?",
            model.name,
            model.guid
        );
        Ok(())
    }

    /// Compresses the binary, or takes it from the folder `cache`, which stores compressed binaries
    /// by the checksum of their content.
    ///
    /// # Errors
    /// The binary is too large for an archive.
    pub fn pack(&self, compression: Compression, cache: &Path) -> Result<PackedBinary> {
        let cached = cache.join(format!("{:032x}-{compression:?}", checksum(&self.bytes)));
        let known = fs::read(&cached).ok();
        let known = known.and_then(|packed| Packed::from_bytes(packed, &self.bytes));
        let file = match known {
            Some(file) => file,
            None => {
                let file = Packed::program(&self.bytes, compression)?;
                // Without the cache, the next export only takes longer.
                let _ = replace::write(&cached, file.as_bytes());
                file
            }
        };
        Ok(PackedBinary {
            platforms: self.platforms.clone(),
            file,
        })
    }
}

/// Builds a library with one recipe.
fn build(
    library: &Library,
    recipe: &Recipe,
    extension: &str,
    metadata: &Metadata,
) -> Result<Vec<u8>> {
    // As the only crate type, a `cdylib` gets LTO, which is not possible together with an rlib.
    let file = recipe
        .cargo_rustc(&format!("building {}", library.package))
        .args(["--release", "--lib", "--crate-type", "cdylib"])
        .args(["--package", &library.package])
        .without_local_paths(metadata, recipe.sources().as_deref())
        .args(["--"])
        .args(recipe.compiler_args(&library.target))
        .run(metadata.packages.len())?
        .shared_library(&library.target, extension)
        .with_context(|| format!("cargo built no shared library of {}", library.package))?;
    fs::read(&file).with_context(|| format!("cannot read {}", file.display()))
}
