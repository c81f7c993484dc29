//! `modelDescription.xml` of FMI 2.0.4 as data: written in the order of the standard's schema, and
//! read from any FMU for co-simulation.

use quick_xml::se::Serializer;
use serde::{Deserialize, Serialize};

/// Why a model description could not be read.
#[derive(Debug)]
pub struct Error(String);

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

/// The root element.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename = "fmiModelDescription", rename_all = "PascalCase")]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct ModelDescription {
    #[serde(rename = "@fmiVersion")]
    pub fmi_version: String,
    #[serde(rename = "@modelName")]
    pub model_name: String,
    #[serde(rename = "@guid")]
    pub guid: String,
    #[serde(
        rename = "@description",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub description: Option<String>,
    #[serde(rename = "@version", default, skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    #[serde(rename = "@license", default, skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
    #[serde(
        rename = "@generationTool",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub generation_tool: Option<String>,
    #[serde(
        rename = "@variableNamingConvention",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub variable_naming_convention: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub co_simulation: Option<CoSimulation>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit_definitions: Option<UnitDefinitions>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub type_definitions: Option<TypeDefinitions>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_categories: Option<LogCategories>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub default_experiment: Option<DefaultExperiment>,
    pub model_variables: ModelVariables,
    pub model_structure: ModelStructure,
}

/// What the FMU can do as a slave.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct CoSimulation {
    #[serde(rename = "@modelIdentifier")]
    pub model_identifier: String,
    #[serde(rename = "@needsExecutionTool")]
    pub needs_execution_tool: bool,
    #[serde(rename = "@canHandleVariableCommunicationStepSize")]
    pub can_handle_variable_communication_step_size: bool,
    #[serde(rename = "@canInterpolateInputs")]
    pub can_interpolate_inputs: bool,
    #[serde(rename = "@maxOutputDerivativeOrder")]
    pub max_output_derivative_order: u32,
    /// The standard spells it so.
    #[serde(rename = "@canRunAsynchronuously")]
    pub can_run_asynchronuously: bool,
    #[serde(rename = "@canBeInstantiatedOnlyOncePerProcess")]
    pub can_be_instantiated_only_once_per_process: bool,
    #[serde(rename = "@canNotUseMemoryManagementFunctions")]
    pub can_not_use_memory_management_functions: bool,
    #[serde(rename = "@canGetAndSetFMUstate")]
    pub can_get_and_set_fmu_state: bool,
    #[serde(rename = "@canSerializeFMUstate")]
    pub can_serialize_fmu_state: bool,
    #[serde(rename = "@providesDirectionalDerivative")]
    pub provides_directional_derivative: bool,
}

impl CoSimulation {
    /// The capability flags by name, in the order of the XML.
    pub fn capabilities(&self) -> [(&'static str, bool); 9] {
        [
            ("needsExecutionTool", self.needs_execution_tool),
            (
                "canHandleVariableCommunicationStepSize",
                self.can_handle_variable_communication_step_size,
            ),
            ("canInterpolateInputs", self.can_interpolate_inputs),
            ("canRunAsynchronuously", self.can_run_asynchronuously),
            (
                "canBeInstantiatedOnlyOncePerProcess",
                self.can_be_instantiated_only_once_per_process,
            ),
            (
                "canNotUseMemoryManagementFunctions",
                self.can_not_use_memory_management_functions,
            ),
            ("canGetAndSetFMUstate", self.can_get_and_set_fmu_state),
            ("canSerializeFMUstate", self.can_serialize_fmu_state),
            (
                "providesDirectionalDerivative",
                self.provides_directional_derivative,
            ),
        ]
    }
}

/// A list element that holds elements of one name.
macro_rules! list {
    ($(#[$about:meta])* $list:ident of $item:ident as $field:ident, $tag:literal) => {
        $(#[$about])*
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        pub struct $list {
            /// The elements.
            #[serde(rename = $tag, default)]
            pub $field: Vec<$item>,
        }
    };
}

list!(
    /// All units used.
    UnitDefinitions of Unit as units, "Unit"
);
list!(
    /// All named types.
    TypeDefinitions of SimpleType as types, "SimpleType"
);
list!(
    /// All log categories.
    LogCategories of Category as categories, "Category"
);
list!(
    /// All variables, in the order of their indices.
    ModelVariables of ScalarVariable as variables, "ScalarVariable"
);

/// A unit, by its base unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct Unit {
    #[serde(rename = "@name")]
    pub name: String,
    #[serde(rename = "BaseUnit", default, skip_serializing_if = "Option::is_none")]
    pub base: Option<BaseUnit>,
    #[serde(rename = "DisplayUnit", default)]
    pub display: Vec<DisplayUnit>,
}

/// Exponents of the SI base units and radians.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct BaseUnit {
    #[serde(rename = "@kg", skip_serializing_if = "is_zero")]
    pub kg: i32,
    #[serde(rename = "@m", skip_serializing_if = "is_zero")]
    pub m: i32,
    #[serde(rename = "@s", skip_serializing_if = "is_zero")]
    pub s: i32,
    #[serde(rename = "@A", skip_serializing_if = "is_zero")]
    pub ampere: i32,
    #[serde(rename = "@K", skip_serializing_if = "is_zero")]
    pub kelvin: i32,
    #[serde(rename = "@mol", skip_serializing_if = "is_zero")]
    pub mol: i32,
    #[serde(rename = "@cd", skip_serializing_if = "is_zero")]
    pub cd: i32,
    #[serde(rename = "@rad", skip_serializing_if = "is_zero")]
    pub rad: i32,
}

#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_zero(exponent: &i32) -> bool {
    *exponent == 0
}

/// A unit for people.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct DisplayUnit {
    #[serde(rename = "@name")]
    pub name: String,
    #[serde(rename = "@factor", default = "one")]
    pub factor: f64,
}

fn one() -> f64 {
    1.0
}

/// A named type.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct SimpleType {
    #[serde(rename = "@name")]
    pub name: String,
    #[serde(
        rename = "@description",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub description: Option<String>,
    #[serde(
        rename = "Enumeration",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub enumeration: Option<Enumeration>,
}

list!(
    /// The items of an enumeration type.
    Enumeration of Item as items, "Item"
);

/// An item of an enumeration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct Item {
    #[serde(rename = "@name")]
    pub name: String,
    #[serde(rename = "@value")]
    pub value: i32,
    #[serde(
        rename = "@description",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub description: Option<String>,
}

/// A log category.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct Category {
    #[serde(rename = "@name")]
    pub name: String,
    #[serde(
        rename = "@description",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub description: Option<String>,
}

/// The experiment that the model is made for.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct DefaultExperiment {
    #[serde(rename = "@startTime", skip_serializing_if = "Option::is_none")]
    pub start_time: Option<f64>,
    #[serde(rename = "@stopTime", skip_serializing_if = "Option::is_none")]
    pub stop_time: Option<f64>,
    #[serde(rename = "@tolerance", skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    #[serde(rename = "@stepSize", skip_serializing_if = "Option::is_none")]
    pub step_size: Option<f64>,
}

/// A variable.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "PascalCase")]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct ScalarVariable {
    #[serde(rename = "@name")]
    pub name: String,
    #[serde(rename = "@valueReference")]
    pub value_reference: u32,
    #[serde(
        rename = "@description",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub description: Option<String>,
    #[serde(
        rename = "@causality",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub causality: Option<String>,
    #[serde(
        rename = "@variability",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub variability: Option<String>,
    #[serde(rename = "@initial", default, skip_serializing_if = "Option::is_none")]
    pub initial: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub real: Option<Attributes>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub integer: Option<Attributes>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boolean: Option<Attributes>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub string: Option<Attributes>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub enumeration: Option<Attributes>,
}

impl ScalarVariable {
    /// The type's name and its attributes.
    pub fn value(&self) -> Option<(&'static str, &Attributes)> {
        [
            ("Real", &self.real),
            ("Integer", &self.integer),
            ("Boolean", &self.boolean),
            ("String", &self.string),
            ("Enumeration", &self.enumeration),
        ]
        .into_iter()
        .find_map(|(name, value)| value.as_ref().map(|value| (name, value)))
    }
}

/// Attributes of a value. Numbers stay text, as each type has its own form.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct Attributes {
    #[serde(rename = "@declaredType", skip_serializing_if = "Option::is_none")]
    pub declared_type: Option<String>,
    #[serde(rename = "@unit", skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    #[serde(rename = "@displayUnit", skip_serializing_if = "Option::is_none")]
    pub display_unit: Option<String>,
    #[serde(rename = "@min", skip_serializing_if = "Option::is_none")]
    pub min: Option<String>,
    #[serde(rename = "@max", skip_serializing_if = "Option::is_none")]
    pub max: Option<String>,
    #[serde(rename = "@start", skip_serializing_if = "Option::is_none")]
    pub start: Option<String>,
}

/// Which variables depend on which.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, rename_all = "PascalCase")]
#[allow(missing_docs, reason = "the names of the standard")]
pub struct ModelStructure {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outputs: Option<Unknowns>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_unknowns: Option<Unknowns>,
}

list!(
    /// Variables that are computed.
    Unknowns of Unknown as unknowns, "Unknown"
);

/// A computed variable, by its index from 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unknown {
    /// Index of the variable, from 1.
    #[serde(rename = "@index")]
    pub index: u32,
    /// Indices of the variables that it depends on, separated by spaces; without it, on all.
    #[serde(
        rename = "@dependencies",
        default,
        skip_serializing_if = "Option::is_none"
    )]
    pub dependencies: Option<String>,
}

impl ModelDescription {
    /// Reads a model description.
    ///
    /// # Errors
    /// The text is not XML, or not that of a model description.
    pub fn from_xml(xml: &str) -> Result<Self, Error> {
        quick_xml::de::from_str(xml).map_err(|e| Error(e.to_string()))
    }

    /// Writes the model description, indented, with the XML declaration.
    ///
    /// # Errors
    /// A text holds what XML cannot.
    pub fn to_xml(&self) -> Result<String, Error> {
        let mut xml = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
        let mut serializer = Serializer::new(&mut xml);
        serializer.indent(' ', 2);
        self.serialize(serializer)
            .map_err(|e| Error(e.to_string()))?;
        xml.push('\n');
        Ok(xml)
    }
}
