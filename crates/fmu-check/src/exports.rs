//! Checks which functions of FMI 3.0 a binary exports, without running it, so also those for other
//! machines.

use std::collections::BTreeSet;

use fmu_description::xml::Element;
use fmu_file::archive::Archive;

use crate::finding::Findings;
use crate::package::interfaces;
use crate::rule::rules;

rules! {
    /// The functions of a binary.
    pub EXPORTS {
        EXPORTED: Error, "functions-exported", Fmi3("section 2.5"),
            "A binary exports all functions of its interface types.";
    }
}

/// Larger binaries are not read.
const MAX_SIZE: u64 = 128 << 20;

/// Functions of all interface types (FMI 3.0.2, `fmi3Functions.h`).
const COMMON: &[&str] = &[
    "fmi3GetVersion",
    "fmi3SetDebugLogging",
    "fmi3FreeInstance",
    "fmi3EnterInitializationMode",
    "fmi3ExitInitializationMode",
    "fmi3EnterEventMode",
    "fmi3Terminate",
    "fmi3Reset",
    "fmi3GetFloat32",
    "fmi3GetFloat64",
    "fmi3GetInt8",
    "fmi3GetUInt8",
    "fmi3GetInt16",
    "fmi3GetUInt16",
    "fmi3GetInt32",
    "fmi3GetUInt32",
    "fmi3GetInt64",
    "fmi3GetUInt64",
    "fmi3GetBoolean",
    "fmi3GetString",
    "fmi3GetBinary",
    "fmi3GetClock",
    "fmi3SetFloat32",
    "fmi3SetFloat64",
    "fmi3SetInt8",
    "fmi3SetUInt8",
    "fmi3SetInt16",
    "fmi3SetUInt16",
    "fmi3SetInt32",
    "fmi3SetUInt32",
    "fmi3SetInt64",
    "fmi3SetUInt64",
    "fmi3SetBoolean",
    "fmi3SetString",
    "fmi3SetBinary",
    "fmi3SetClock",
    "fmi3GetNumberOfVariableDependencies",
    "fmi3GetVariableDependencies",
    "fmi3GetFMUState",
    "fmi3SetFMUState",
    "fmi3FreeFMUState",
    "fmi3SerializedFMUStateSize",
    "fmi3SerializeFMUState",
    "fmi3DeserializeFMUState",
    "fmi3GetDirectionalDerivative",
    "fmi3GetAdjointDerivative",
    "fmi3EnterConfigurationMode",
    "fmi3ExitConfigurationMode",
    "fmi3GetIntervalDecimal",
    "fmi3GetIntervalFraction",
    "fmi3GetShiftDecimal",
    "fmi3GetShiftFraction",
    "fmi3SetIntervalDecimal",
    "fmi3SetIntervalFraction",
    "fmi3SetShiftDecimal",
    "fmi3SetShiftFraction",
    "fmi3EvaluateDiscreteStates",
    "fmi3UpdateDiscreteStates",
];

/// Further functions of each interface type.
const FURTHER: [(&str, &[&str]); 3] = [
    (
        "ModelExchange",
        &[
            "fmi3InstantiateModelExchange",
            "fmi3EnterContinuousTimeMode",
            "fmi3CompletedIntegratorStep",
            "fmi3SetTime",
            "fmi3SetContinuousStates",
            "fmi3GetContinuousStateDerivatives",
            "fmi3GetEventIndicators",
            "fmi3GetContinuousStates",
            "fmi3GetNominalsOfContinuousStates",
            "fmi3GetNumberOfEventIndicators",
            "fmi3GetNumberOfContinuousStates",
        ],
    ),
    (
        "CoSimulation",
        &[
            "fmi3InstantiateCoSimulation",
            "fmi3EnterStepMode",
            "fmi3GetOutputDerivatives",
            "fmi3DoStep",
        ],
    ),
    (
        "ScheduledExecution",
        &[
            "fmi3InstantiateScheduledExecution",
            "fmi3ActivateModelPartition",
        ],
    ),
];

/// Checks a binary, which is the shared library of all interface types with this identifier.
pub fn check(
    file: &str,
    identifier: &str,
    root: &Element<'_>,
    archive: &mut Archive,
    findings: &mut Findings,
) {
    let Ok(binary) = archive.head(file, MAX_SIZE + 1) else {
        return;
    };
    if binary.len() as u64 > MAX_SIZE || !has_plain_names(&binary) {
        return;
    }
    let further = interfaces(root)
        .filter(|interface| interface.attribute("modelIdentifier") == Some(identifier))
        .filter_map(|interface| FURTHER.iter().find(|(name, _)| *name == interface.name))
        .flat_map(|(_, names)| *names);
    for name in missing(&binary, COMMON.iter().chain(further)) {
        let text =
            format!("it does not export {name}, expected all functions of its interface types");
        findings.add(&EXPORTED, file, text);
    }
}

/// Whether the names of exported functions are texts in the binary. Those of macOS may be compressed.
fn has_plain_names(binary: &[u8]) -> bool {
    binary.starts_with(b"\x7fELF") || binary.starts_with(b"MZ")
}

/// Those of the names that are not in a binary as texts with a zero byte behind.
fn missing<'a>(
    binary: &[u8],
    names: impl Iterator<Item = &'a &'static str>,
) -> BTreeSet<&'static str> {
    const PREFIX: &[u8] = b"fmi3";
    const MAX_LENGTH: usize = 64;
    let mut missing: BTreeSet<&str> = names.copied().collect();
    for at in 0..binary.len() {
        let rest = &binary[at..];
        if rest.starts_with(PREFIX)
            && let Some(end) = rest.iter().take(MAX_LENGTH).position(|byte| *byte == 0)
            && let Ok(name) = str::from_utf8(&rest[..end])
        {
            missing.remove(name);
        }
    }
    missing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_end_with_a_zero_byte() {
        // The last has no end; a name may be the end of another.
        let binary = b"\0fmi3Reset\0my_fmi3DoStep\0fmi3SetTimes\0fmi3Terminate";
        let names = ["fmi3Reset", "fmi3DoStep", "fmi3SetTime", "fmi3Terminate"];
        let missing = missing(binary, names.iter());
        assert_eq!(missing, BTreeSet::from(["fmi3SetTime", "fmi3Terminate"]));
    }
}
