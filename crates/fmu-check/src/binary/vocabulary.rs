//! The names of functions and flags in the version of the FMU.

use fmu_description::FmiVersion;
use fmu_description::value::boolean;
use fmu_description::xml::Element;
use fmu_host::InterfaceType;

/// The flag of an FMU of which a process has one instance at most.
pub const ONLY_ONCE: &str = "canBeInstantiatedOnlyOncePerProcess";

/// The names of FMI 2.0 in a text, as they are in a version of FMI for a kind of instance. What is in quotes is the
/// FMU's.
pub fn in_version(text: &str, version: FmiVersion, interface_type: InterfaceType) -> String {
    let instantiate = interface_type.instantiation(FmiVersion::Fmi3);
    let names: [[&str; 2]; 14] = [
        ["fmi2Instantiate", instantiate],
        ["fmi2GetRealOutputDerivatives", "fmi3GetOutputDerivatives"],
        ["fmi2GetReal", "fmi3GetFloat64"],
        ["fmi2SetReal", "fmi3SetFloat64"],
        ["fmi2GetInteger", "fmi3GetInt32"],
        ["fmi2SetInteger", "fmi3SetInt32"],
        ["fmi2GetDerivatives", "fmi3GetContinuousStateDerivatives"],
        ["fmi2NewDiscreteStates", "fmi3UpdateDiscreteStates"],
        ["fmi2SetupExperiment", "fmi3EnterInitializationMode"],
        ["FMUstate", "FMUState"],
        ["DeSerialize", "Deserialize"],
        ["providesDirectionalDerivative", "providesDirectionalDerivatives"],
        ["the GUID", "the instantiationToken"],
        ["fmi2", "fmi3"],
    ];
    if version == FmiVersion::Fmi2 {
        return text.to_owned();
    }
    let rename = |text: String, [old, new]: &[&str; 2]| text.replace(old, new);
    let mut is_quoted = false;
    let parts = text.split_inclusive('"').map(|part| {
        let renamed = match is_quoted {
            true => part.to_owned(),
            false => names.iter().fold(part.to_owned(), rename),
        };
        let before = part.trim_end_matches('"');
        let escapes = before.len() - before.trim_end_matches('\\').len();
        is_quoted = !is_quoted || escapes % 2 == 1;
        renamed
    });
    parts.collect()
}

#[test]
fn names_of_functions_are_those_of_the_version_but_not_in_quotes() {
    let text = r#"fmi2SetReal for "fmi2\" and "a\"fmi2", fmi2Reset"#;
    assert_eq!(in_version(text, FmiVersion::Fmi2, InterfaceType::CoSimulation), text);
    let expected = r#"fmi3SetFloat64 for "fmi2\" and "a\"fmi2", fmi3Reset"#;
    assert_eq!(in_version(text, FmiVersion::Fmi3, InterfaceType::CoSimulation), expected);
    let of_exchange = in_version("fmi2Instantiate", FmiVersion::Fmi3, InterfaceType::ModelExchange);
    assert_eq!(of_exchange, "fmi3InstantiateModelExchange");
}

/// Whether an interface type declares a flag, named as in FMI 2.0.
pub fn claims(element: &Element<'_>, flag: &str, version: FmiVersion) -> bool {
    let flag = element.attribute(&in_version(flag, version, InterfaceType::default()));
    flag.and_then(boolean) == Some(true)
}
