//! The shared libraries of FMUs: built, or given as files that were built elsewhere.

use std::fs;
use std::path::Path;
use std::ptr;

use anyhow::{Context, Result, anyhow, ensure};
use fmu_description::{ExportedModel, FmiVersion, InterfaceType, read_interfaces};
use fmu_file::platform::{Platform, Prebuilt};

use crate::library::ModelLibrary;
use crate::model::BuiltModel;

/// A shared library for one or more platforms.
pub struct PlatformBinary<'a> {
    /// The library that it was built from, or its file if it was built elsewhere.
    pub source: BinarySource<'a>,
    pub platforms: Vec<Platform>,
    pub bytes: Vec<u8>,
    /// The models in it.
    pub models: Vec<ExportedModel>,
}

/// Where a binary comes from.
#[derive(Clone, Copy)]
pub enum BinarySource<'a> {
    Library(&'a ModelLibrary),
    File(&'a Path),
}

impl<'a> PlatformBinary<'a> {
    /// Reads a prebuilt binary.
    pub fn read(prebuilt: &'a Prebuilt, version: FmiVersion) -> Result<Self> {
        let file = prebuilt.file.display();
        let bytes = fs::read(&prebuilt.file).with_context(|| format!("cannot read {file}"))?;
        let models = prebuilt
            .platform
            .check(&bytes)
            .and_then(|()| check_functions(&bytes, version))
            .and_then(|()| read_interfaces(&bytes))
            .with_context(|| format!("{file} cannot be used"))?;
        Ok(Self {
            source: BinarySource::File(&prebuilt.file),
            platforms: vec![prebuilt.platform],
            bytes,
            models,
        })
    }

    /// The model with the given name.
    pub fn model(&self, name: &str) -> Option<&ExportedModel> {
        self.models.iter().find(|model| model.name == name)
    }

    /// Whether it is for the FMU of a model: it was built from the library of the model, or elsewhere.
    pub fn may_have(&self, model: &BuiltModel<'_>) -> bool {
        match self.source {
            BinarySource::Library(library) => ptr::eq(library, model.library),
            BinarySource::File(_) => true,
        }
    }

    /// Checks that a binary for a model contains the model in the same version, and the functions of its interface types.
    pub fn check_model(&self, model: &BuiltModel<'_>) -> Result<()> {
        if !self.may_have(model) {
            return Ok(());
        }
        let checked = self.find(&model.description, model.version);
        match self.source {
            BinarySource::Library(_) => checked,
            BinarySource::File(file) => {
                checked.map_err(|reason| anyhow!("{} cannot be used: {reason}", file.display()))
            }
        }
    }

    fn find(&self, model: &ExportedModel, version: FmiVersion) -> Result<()> {
        let ExportedModel { name, guid, .. } = model;
        ensure!(
            self.models.iter().any(|known| known.guid == *guid),
            "it does not contain the model {name} with the GUID {guid}; was it built from another version?"
        );
        // FMI 2.0 has no scheduled execution.
        let is_possible = |it: &InterfaceType| {
            version == FmiVersion::Fmi3 || *it != InterfaceType::ScheduledExecution
        };
        for interface_type in InterfaceType::ALL.into_iter().filter(is_possible) {
            ensure!(
                !model.is_for(interface_type)
                    || has_functions(&self.bytes, version, interface_type),
                "it does not export the functions of FMI {} for {}; was it exported with another --interface?",
                version.as_str(),
                interface_type.as_str()
            );
        }
        Ok(())
    }
}

/// Leaves the platforms of prebuilt binaries to them.
pub fn drop_replaced(built: &mut Vec<PlatformBinary<'_>>, prebuilt: &[PlatformBinary<'_>]) {
    let taken = Vec::from_iter(prebuilt.iter().flat_map(|binary| &binary.platforms));
    built.retain_mut(|binary| {
        binary.platforms.retain(|platform| !taken.contains(&platform));
        !binary.platforms.is_empty()
    });
}

/// Checks that a binary has the names of the functions of a version of FMI, for one of the interface types at least.
pub fn check_functions(binary: &[u8], version: FmiVersion) -> Result<()> {
    ensure!(
        InterfaceType::ALL.into_iter().any(|interface_type| has_functions(
            binary,
            version,
            interface_type
        )),
        "it does not export the functions of FMI {}",
        version.as_str()
    );
    Ok(())
}

/// Whether a binary has the name of a function that only one interface type has.. Every binary has the name of `DoStep`.
fn has_functions(binary: &[u8], version: FmiVersion, interface_type: InterfaceType) -> bool {
    let name: &[u8] = match (version, interface_type) {
        (FmiVersion::Fmi2, InterfaceType::CoSimulation) => b"fmi2CancelStep",
        (FmiVersion::Fmi2, InterfaceType::ModelExchange) => b"fmi2SetTime",
        (FmiVersion::Fmi3, InterfaceType::CoSimulation) => b"fmi3EnterStepMode",
        (FmiVersion::Fmi3, InterfaceType::ModelExchange) => b"fmi3SetTime",
        (FmiVersion::Fmi2, InterfaceType::ScheduledExecution) => return false,
        (FmiVersion::Fmi3, InterfaceType::ScheduledExecution) => b"fmi3ActivateModelPartition",
    };
    binary.windows(name.len()).any(|bytes| bytes == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prebuilt_binary_replaces_another_in_its_folder_only() {
        let arm = Platform::of_target("aarch64-apple-darwin", FmiVersion::Fmi2).unwrap();
        let binary = |platforms: &[Platform]| PlatformBinary {
            source: BinarySource::File(Path::new("")),
            platforms: platforms.to_vec(),
            bytes: Vec::new(),
            models: Vec::new(),
        };
        for (prebuilt, expected) in [(&arm[..1], &[&arm[1..]][..]), (&arm, &[])] {
            let mut built = vec![binary(&arm)];
            drop_replaced(&mut built, &[binary(prebuilt)]);
            assert_eq!(Vec::from_iter(built.iter().map(|b| &*b.platforms)), expected);
        }
    }
}
