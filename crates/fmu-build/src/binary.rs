//! The shared libraries of models: builds or reads, checks and compresses them.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use cargo_metadata::Metadata;
use fmu_description::guid::checksum;
use fmu_description::{Description, FmiVersion, read_interfaces};
use fmu_file::archive::{Compression, Packed};
use fmu_file::platform::{Platform, Prebuilt};
use fmu_file::replace;

use crate::library::{Library, Selection};
use crate::macho;
use crate::toolchain::{Recipe, Target};

/// A shared library for one or more platforms.
pub struct Binary {
    platforms: Vec<Platform>,
    bytes: Vec<u8>,
    /// The models in it.
    models: Vec<Description>,
}

/// A compressed shared library.
pub struct PackedBinary {
    /// Its platforms.
    pub platforms: Vec<Platform>,
    /// Its content.
    pub file: Packed,
}

impl Binary {
    /// Builds a library for a target; `variant` is the text of a [`Variant`](crate::Variant).
    ///
    /// # Errors
    /// The diagnostics of the compiler, or the library has no models.
    pub fn build(
        library: &Library,
        target: &Target,
        method: &Method<'_>,
        variant: Option<&str>,
    ) -> Result<Self> {
        let mut parts = target
            .recipes
            .iter()
            .map(|recipe| method.run(library, recipe, target.platforms[0].extension, variant))
            .collect::<Result<Vec<_>>>()?;
        let bytes = match parts.len() {
            1 => parts.remove(0),
            _ => macho::join(&parts).context("cannot join the parts of a universal binary")?,
        };
        let models = read_interfaces(&bytes)
            .with_context(|| format!("the library of {} cannot be used", library.package))?;
        ensure!(
            !models.is_empty(),
            "the library of {} has no model; write in {}, with the name of the struct of your model:\n\nfmu_export::export!(MyModel);",
            library.package,
            library.folder.join("src/lib.rs").display()
        );
        Ok(Self {
            platforms: target.platforms.clone(),
            bytes,
            models,
        })
    }

    /// Reads a prebuilt binary.
    ///
    /// # Errors
    /// The file cannot be read, has another platform's format, or is for another version of FMI.
    pub fn read(prebuilt: &Prebuilt, version: FmiVersion) -> Result<Self> {
        let file = prebuilt.file.display();
        let bytes = fs::read(&prebuilt.file).with_context(|| format!("cannot read {file}"))?;
        let models = prebuilt
            .platform
            .check(&bytes)
            .and_then(|()| check_functions(&bytes, version))
            .and_then(|()| read_interfaces(&bytes))
            .with_context(|| format!("{file} cannot be used"))?;
        Ok(Self {
            platforms: vec![prebuilt.platform],
            bytes,
            models,
        })
    }

    /// The models in the binary.
    pub fn models(&self) -> &[Description] {
        &self.models
    }

    /// Whether both are for the same platform.
    pub fn replaces(&self, other: &Self) -> bool {
        self.platforms.iter().any(|p| other.platforms.contains(p))
    }

    /// Checks that the binary contains a model in the same version.
    ///
    /// # Errors
    /// It does not.
    pub fn check_model(&self, model: &Description) -> Result<()> {
        ensure!(
            self.models.iter().any(|known| known.guid == model.guid),
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

/// Checks that a binary has the names of the functions of a version of FMI.
fn check_functions(binary: &[u8], version: FmiVersion) -> Result<()> {
    let name: &[u8] = match version {
        FmiVersion::Fmi2 => b"fmi2DoStep",
        FmiVersion::Fmi3 => b"fmi3DoStep",
    };
    let mut names = binary.windows(name.len());
    ensure!(
        names.any(|bytes| bytes == name),
        "it does not export the functions of FMI {}",
        version.as_str()
    );
    Ok(())
}

/// Keeps the compiler from joining neighbouring values in vectors. A step touches each value once, and a
/// vector cannot be loaded before the stores of its parts have left the processor's store buffer.
const NO_SLP: &str = "-Cno-vectorize-slp";

/// How libraries are built.
pub struct Method<'a> {
    /// Options for cargo.
    pub selection: &'a Selection,
    /// The workspace of the packages.
    pub metadata: &'a Metadata,
    /// Settings of the profile that the workspace does not make itself.
    pub profile: &'a [String],
    /// The version of FMI whose functions the libraries export.
    pub version: FmiVersion,
}

impl Method<'_> {
    /// Arguments for cargo's target folder. The libraries of both versions have the same names, so each
    /// version has its own folder, and an export of one does not make that of the other build again.
    fn folder(&self) -> Vec<String> {
        let folder = match self.version {
            FmiVersion::Fmi2 => return Vec::new(),
            FmiVersion::Fmi3 => self.metadata.target_directory.join("fmi3"),
        };
        vec!["--target-dir".to_owned(), folder.into_string()]
    }

    /// Builds a library with one recipe, and reads it.
    fn run(
        &self,
        library: &Library,
        recipe: &Recipe,
        extension: &str,
        variant: Option<&str>,
    ) -> Result<Vec<u8>> {
        // As the only crate type, a `cdylib` gets LTO, which is not possible together with an rlib.
        let mut build = recipe.cargo_rustc(&format!("building {}", library.package));
        build
            .args(["--lib", "--crate-type", "cdylib"])
            .args(["--package", &library.package])
            .args(self.selection.cargo_arguments())
            .args(
                self.profile
                    .iter()
                    .flat_map(|setting| ["--config", setting]),
            )
            .args(self.folder())
            .args(
                library
                    .feature(self.version)?
                    .iter()
                    .flat_map(|feature| ["--features", feature]),
            )
            // Whatever the profile says: an abort would end the host.
            .rustflags(["-Cpanic=unwind".to_owned()])
            .without_local_paths(self.metadata, recipe.sources().as_deref());
        if let Some(variant) = variant {
            build.env("FMU_EXPORT_VARIANT", variant);
        }
        let file = build
            .args(["--", NO_SLP])
            .args(recipe.compiler_args(&library.target))
            .run(self.metadata.packages.len())?
            .shared_library(&library.target, extension)
            .with_context(|| format!("cargo built no shared library of {}", library.package))?;
        fs::read(&file).with_context(|| format!("cannot read {}", file.display()))
    }
}
